//! The client against servers that do what servers should not.

use crate::client::{API_VERSION, DEFAULT_TIMEOUT};
use crate::*;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};

/// Reads one message as a server.
async fn request(server: &mut DuplexStream) -> Vec<u8> {
    let length = server.read_i32().await.unwrap();
    let mut body = vec![0; length as usize - 4];
    server.read_exact(&mut body).await.unwrap();
    body
}

/// A message with its length field.
fn message(body: &[u8]) -> Vec<u8> {
    let mut out = (body.len() as i32 + 4).to_be_bytes().to_vec();
    out.extend(body);
    out
}

fn status(command: u8) -> Vec<u8> {
    vec![7, command, 0, 0, 0, 0, 0]
}

fn version_answer(api: i32) -> Vec<u8> {
    let mut body = status(0x00);
    let software = b"SUMO 1.28.0";
    body.extend([2 + 4 + 4 + software.len() as u8, 0x00]);
    body.extend(api.to_be_bytes());
    body.extend((software.len() as i32).to_be_bytes());
    body.extend(software);
    message(&body)
}

/// A client past its handshake, and the server's end.
async fn connected() -> (Client<DuplexStream>, DuplexStream) {
    let (near, mut server) = duplex(1 << 20);
    let serve = async {
        assert_eq!(request(&mut server).await, [2, 0x00]);
        server.write_all(&version_answer(API_VERSION)).await.unwrap();
        assert_eq!(request(&mut server).await, [6, 0x03, 0, 0, 0, 1]);
        server.write_all(&message(&status(0x03))).await.unwrap();
        server
    };
    let (client, server) = tokio::join!(Client::handshake(near, 1, DEFAULT_TIMEOUT), serve);
    (client.unwrap(), server)
}

/// What the handshake makes of a server that answers with `bytes` and closes.
async fn handshake_with(bytes: Vec<u8>) -> Error {
    let (near, mut server) = duplex(1 << 20);
    server.write_all(&bytes).await.unwrap();
    server.shutdown().await.unwrap();
    Client::handshake(near, 1, DEFAULT_TIMEOUT).await.unwrap_err()
}

fn speed_answer() -> Vec<u8> {
    let mut body = status(0xa4);
    body.extend([0x11, 0xb4, 0x40, 0, 0, 0, 1, b'v', 0x0b, 0x3f, 0xf8, 0, 0, 0, 0, 0, 0]);
    message(&body)
}

#[tokio::test]
async fn a_reply_may_come_byte_by_byte() {
    let (mut client, mut server) = connected().await;
    let serve = async {
        request(&mut server).await;
        for byte in speed_answer() {
            server.write_all(&[byte]).await.unwrap();
            tokio::task::yield_now().await;
        }
    };
    let (speed, ()) = tokio::join!(client.get(vehicle::SPEED, "v"), serve);
    assert_eq!(speed.unwrap(), 1.5);
}

#[tokio::test]
async fn a_message_is_one_write() {
    let (mut client, mut server) = connected().await;
    let serve = async {
        // What a single read brings is what a single write sent.
        let mut buffer = [0; 4096];
        let n = server.read(&mut buffer).await.unwrap();
        server.write_all(&speed_answer()).await.unwrap();
        buffer[..n].to_vec()
    };
    let (_, sent) = tokio::join!(client.get(vehicle::SPEED, "v"), serve);
    assert_eq!(sent, [0, 0, 0, 12, 8, 0xa4, 0x40, 0, 0, 0, 1, b'v']);
}

#[tokio::test]
async fn a_server_that_closes_in_the_middle_is_closed() {
    let (mut client, mut server) = connected().await;
    let serve = async {
        request(&mut server).await;
        server.write_all(&speed_answer()[..10]).await.unwrap();
        drop(server);
    };
    let (speed, ()) = tokio::join!(client.get(vehicle::SPEED, "v"), serve);
    let error = speed.unwrap_err();
    assert!(error.is_closed() && error.is_fatal(), "{error:?}");
    let text = error.to_string();
    assert!(text.contains("get vehicle SPEED 'v'") && text.contains("6 of 24 bytes"), "{text}");
    assert!(matches!(client.step().await, Err(Error::Unusable)));
}

#[tokio::test]
async fn another_version_is_refused_by_number() {
    let error = handshake_with(version_answer(API_VERSION - 1)).await;
    let text = error.to_string();
    assert!(matches!(error, Error::Version { .. }), "{error:?}");
    for words in ["21", "22", "SUMO 1.28.0", "scripts/setup"] {
        assert!(text.contains(words), "{words} is not in: {text}");
    }
}

#[tokio::test]
async fn a_newer_version_is_accepted() {
    let (near, mut server) = duplex(1 << 20);
    server.write_all(&version_answer(API_VERSION + 1)).await.unwrap();
    server.write_all(&message(&status(0x03))).await.unwrap();
    let error = Client::handshake(near, 1, DEFAULT_TIMEOUT).await;
    // The second answer came before its question: not a server to trust.
    assert!(matches!(error, Err(Error::Protocol { .. })), "{error:?}");
    let (near, mut server) = duplex(1 << 20);
    let serve = async {
        request(&mut server).await;
        server.write_all(&version_answer(API_VERSION + 1)).await.unwrap();
        request(&mut server).await;
        server.write_all(&message(&status(0x03))).await.unwrap();
    };
    let (client, ()) = tokio::join!(Client::handshake(near, 1, DEFAULT_TIMEOUT), serve);
    assert_eq!(client.unwrap().version().api, API_VERSION + 1);
}

#[tokio::test]
async fn garbage_is_not_traci() {
    let http = b"HTTP/1.1 400 Bad Request\r\n\r\n".to_vec();
    let error = handshake_with(http).await;
    assert!(matches!(error, Error::Protocol { .. }), "{error:?}");
    assert!(error.to_string().contains("message length"), "{error}");
    for body in
        [&[][..], &[0], &[7, 9, 0, 0, 0, 0, 0], &[2, 0], &[7, 0, 0, 0x7f, 0xff, 0xff, 0xff], &[255; 40]]
    {
        let error = handshake_with(message(body)).await;
        assert!(matches!(error, Error::Protocol { .. }), "{body:?}: {error:?}");
    }
    for length in [-1, 0, 3, i32::MIN, i32::MAX] {
        let error = handshake_with(length.to_be_bytes().to_vec()).await;
        assert!(matches!(error, Error::Protocol { .. }), "{length}: {error:?}");
    }
}

#[tokio::test]
async fn a_large_claim_is_read_only_as_far_as_it_arrives() {
    // 900 MB claimed, 20 bytes sent: the connection waits, and allocates no more than it reads ahead.
    let mut bytes = 900_000_000_i32.to_be_bytes().to_vec();
    bytes.extend([0; 20]);
    let error = handshake_with(bytes).await;
    assert!(error.to_string().contains("20 of 899999996 bytes"), "{error}");
}

#[tokio::test(start_paused = true)]
async fn a_server_that_hangs_runs_into_the_time_limit() {
    let (mut client, _server) = connected().await;
    let mut batch = Batch::new();
    batch.set(vehicle::SET_SPEED, "ego", 1.0);
    batch.step();
    let begin = tokio::time::Instant::now();
    let error = client.send(&batch).await.unwrap_err();
    assert_eq!(begin.elapsed().as_secs(), 60);
    let text = error.to_string();
    for words in ["hangs", "60.0 s", "2 commands", "set vehicle SET_SPEED 'ego'", "simulation step"] {
        assert!(text.contains(words), "{words} is not in: {text}");
    }
    client.set_timeout(Some(Duration::from_secs(1)));
    assert!(matches!(client.send(&batch).await, Err(Error::Unusable)));
}

#[tokio::test]
async fn a_dropped_future_leaves_no_stale_answer() {
    let (mut client, mut server) = connected().await;
    {
        let mut pending = Box::pin(client.get(vehicle::SPEED, "v"));
        let first = std::future::poll_fn(|cx| std::task::Poll::Ready(pending.as_mut().poll(cx).is_pending()));
        assert!(first.await);
    }
    request(&mut server).await;
    server.write_all(&speed_answer()).await.unwrap();
    assert!(matches!(client.get(vehicle::SPEED, "w").await, Err(Error::Unusable)));
}

#[tokio::test]
async fn answers_that_do_not_fit_the_question_end_the_connection() {
    let wrong_variable = {
        let mut answer = speed_answer();
        answer[4 + 7 + 2] = 0x41;
        answer
    };
    let two_answers = [speed_answer()[4..].to_vec(), status(0xa4)].concat();
    for answer in [wrong_variable, message(&status(0xa5)), message(&two_answers)] {
        let (mut client, mut server) = connected().await;
        let serve = async {
            request(&mut server).await;
            server.write_all(&answer).await.unwrap();
        };
        let (speed, ()) = tokio::join!(client.get(vehicle::SPEED, "v"), serve);
        assert!(matches!(speed, Err(Error::Protocol { .. })), "{speed:?}");
        assert!(matches!(client.step().await, Err(Error::Unusable)));
    }
}

#[tokio::test]
async fn a_value_of_another_type_is_an_error_in_its_slot_only() {
    let (mut client, mut server) = connected().await;
    let mut batch = Batch::new();
    let wrong = batch.get(Variable::<vehicle::Vehicle, String>::new(0x40, "speed as text"), "v");
    let right = batch.get(vehicle::SPEED, "v");
    let serve = async {
        request(&mut server).await;
        let one = speed_answer()[4..].to_vec();
        server.write_all(&message(&[one.clone(), one].concat())).await.unwrap();
    };
    let (replies, ()) = tokio::join!(client.send(&batch), serve);
    let replies = replies.unwrap();
    let text = replies.get(wrong).unwrap_err().to_string();
    assert!(text.contains("expected string") && text.contains("found double"), "{text}");
    assert_eq!(replies.get(right), Ok(1.5));

    let foreign = Batch::new().get(vehicle::SPEED, "v");
    assert!(replies.get(foreign).unwrap_err().message.contains("another batch"));
}

#[tokio::test]
async fn a_batch_that_may_not_be_sent_leaves_the_connection_alone() {
    let (mut client, mut server) = connected().await;
    let mut batch = Batch::new();
    batch.step();
    batch.step();
    let error = client.send(&batch).await.unwrap_err();
    assert!(!error.is_fatal() && error.to_string().contains("two simulation steps"), "{error}");
    let serve = async {
        request(&mut server).await;
        server.write_all(&speed_answer()).await.unwrap();
    };
    let (speed, ()) = tokio::join!(client.get(vehicle::SPEED, "v"), serve);
    assert_eq!(speed.unwrap(), 1.5);
}

#[tokio::test]
async fn an_empty_batch_is_no_error() {
    let (mut client, mut server) = connected().await;
    let replies = client.send(&Batch::new()).await.unwrap();
    assert_eq!((replies.bytes(), replies.check()), (0, Ok(())));
    let serve = async {
        // The first message after the handshake: nothing was sent for the empty batch.
        assert_eq!(request(&mut server).await[1], 0xa4);
        server.write_all(&speed_answer()).await.unwrap();
    };
    let (speed, ()) = tokio::join!(client.get(vehicle::SPEED, "v"), serve);
    assert_eq!(speed.unwrap(), 1.5);
}

#[tokio::test]
async fn closing_after_a_dropped_future_waits_for_its_answer() {
    let (mut client, mut server) = connected().await;
    let mut batch = Batch::new();
    batch.get(vehicle::SPEED, &"v".repeat(1 << 21));
    let answer = speed_answer();
    {
        // More than the stream takes at once, so the rest of the message is unsent.
        let mut pending = Box::pin(client.send(&batch));
        let first = std::future::poll_fn(|cx| std::task::Poll::Ready(pending.as_mut().poll(cx).is_pending()));
        assert!(first.await);
    }
    let serve = async {
        assert!(request(&mut server).await.len() > 1 << 21);
        for byte in answer {
            server.write_all(&[byte]).await.unwrap();
            tokio::task::yield_now().await;
        }
        assert_eq!(request(&mut server).await, [2, 0x7f]);
        server.write_all(&message(&status(0x7f))).await.unwrap();
    };
    let (closed, ()) = tokio::join!(client.close(), serve);
    closed.unwrap();
}

#[tokio::test(start_paused = true)]
async fn closing_does_not_wait_for_a_server_that_hangs() {
    let (mut client, _server) = connected().await;
    client.set_timeout(Some(Duration::from_secs(1)));
    assert!(matches!(client.step().await, Err(Error::Timeout { .. })));
    assert!(matches!(client.close().await, Err(Error::Unusable)));
    let (mut client, _server) = connected().await;
    {
        let mut pending = Box::pin(client.step());
        let first = std::future::poll_fn(|cx| std::task::Poll::Ready(pending.as_mut().poll(cx).is_pending()));
        assert!(first.await);
    }
    let begin = tokio::time::Instant::now();
    assert!(matches!(client.close().await, Err(Error::Timeout { .. })));
    assert_eq!(begin.elapsed().as_secs(), 5);
}
