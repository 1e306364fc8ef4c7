//! TraCI over TCP: SUMO's control protocol, async on tokio.
