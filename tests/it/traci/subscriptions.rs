//! Variable and context subscriptions.

use super::{Town, add_ego, send, steps};
use wad_cosim::traci::person::{self, Person};
use wad_cosim::traci::traffic_light::{self, TrafficLight};
use wad_cosim::traci::vehicle::{self, Vehicle};
use wad_cosim::traci::*;

#[tokio::test]
async fn variables_come_with_every_step_until_the_vehicle_leaves() {
    let town = Town::new();
    let (_sumo, mut client) = town.launch().await;
    steps(&mut client, 2).await;
    let mut batch = Batch::new();
    let ids = [
        vehicle::SPEED.id(),
        vehicle::leader(100.0).id(),
        vehicle::POSITION_3D.id(),
        vehicle::ROAD_ID.id(),
        vehicle::ROUTE.id(),
        vehicle::parameter_with_key("k").id(),
        vehicle::NEXT_TLS.id(),
    ];
    vehicle::set_parameter(&mut batch, "second", "k", "v");
    let first = batch.subscribe(Vehicle, "second", &ids);
    batch.subscribe(TrafficLight, "B1", &[traffic_light::STATE.id()]);
    batch.subscribe(TrafficLight, "A1", &[traffic_light::STATE.id()]);
    batch.subscribe(simulation::Simulation, "", &[simulation::TIME.id(), simulation::DEPARTED_IDS.id()]);
    batch.step();
    let replies = send(&mut client, &batch).await;
    let now = replies.subscribed(first).unwrap().objects().next().unwrap().value(vehicle::SPEED).unwrap();
    let results = replies.subscriptions();
    assert_eq!(results.len(), 4);
    let car = results.object(Vehicle, "second").unwrap();
    assert!(car.value(vehicle::SPEED).unwrap() > now);
    // Out of order and twice.
    assert_eq!(car.str(vehicle::ROAD_ID).unwrap(), "A1B1");
    assert_eq!(car.value(vehicle::POSITION_3D).unwrap().z, 0.0);
    assert_eq!(car.strings(vehicle::ROUTE).unwrap().collect::<Vec<_>>(), ["A1B1", "B1C1"]);
    assert_eq!(car.value(vehicle::leader(0.0).variable()).unwrap().unwrap().id, "first");
    assert_eq!(car.value(vehicle::parameter_with_key("").variable()).unwrap().value, "v");
    let lights = car.value(vehicle::NEXT_TLS).unwrap();
    assert_eq!((lights[0].id.as_str(), lights.len()), ("B1", 1));
    assert!(lights[0].distance > 50.0 && b"rgGy".contains(&lights[0].state), "{lights:?}");
    let missing = car.value(vehicle::ANGLE).unwrap_err().to_string();
    assert!(
        missing.contains("ANGLE") && missing.contains("second") && missing.contains("not among"),
        "{missing}"
    );

    let mut states: Vec<&str> = results.objects(TrafficLight).map(|light| light.id()).collect();
    states.sort_unstable();
    assert_eq!(states, ["A1", "B1"]);
    let time = results.object(simulation::Simulation, "").unwrap().value(simulation::TIME).unwrap();
    assert_eq!(time, 1.5);

    // A second subscription to the same vehicle adds to the first.
    batch.clear();
    batch.subscribe(Vehicle, "second", &[vehicle::ANGLE.id()]);
    batch.step();
    let replies = send(&mut client, &batch).await;
    let car = replies.subscriptions().object(Vehicle, "second").unwrap();
    assert!(car.value(vehicle::ANGLE).is_ok() && car.value(vehicle::SPEED).is_ok());

    batch.clear();
    batch.unsubscribe(TrafficLight, "A1");
    vehicle::remove(&mut batch, "second", RemoveReason::Vaporized);
    batch.step();
    send(&mut client, &batch).await;
    // The step that takes it out still brings its values.
    let replies = client.step().await.unwrap();
    assert!(replies.subscriptions().object(Vehicle, "second").is_none());
    assert!(replies.subscriptions().object(TrafficLight, "A1").is_none());
    assert!(replies.subscriptions().object(TrafficLight, "B1").is_some());
}

#[tokio::test]
async fn context_subscriptions_bring_what_is_round_the_ego() {
    let town = Town::new();
    let (_sumo, mut client) = town.launch().await;
    add_ego(&mut client).await;
    let mut batch = Batch::new();
    person::add(&mut batch, "near", &person::Add { edge: "A1B1", position: 60.0, ..Default::default() });
    person::add(&mut batch, "far", &person::Add { edge: "C1C2", position: 100.0, ..Default::default() });
    for (id, edge) in [("near", "A1B1"), ("far", "C1C2")] {
        let walk = person::WalkingStage { edges: &[edge], arrival_position: 10.0, ..Default::default() };
        person::append_walking_stage(&mut batch, id, &walk);
    }
    let vehicles = [vehicle::POSITION_3D.id(), vehicle::TYPE.id(), vehicle::SPEED.id()];
    batch.subscribe_context(Vehicle, "ego", Vehicle, 60.0, &vehicles);
    batch.subscribe_context(Vehicle, "ego", Person, 60.0, &[person::POSITION.id(), person::ANGLE.id()]);
    batch.step();
    send(&mut client, &batch).await;
    let replies = client.step().await.unwrap();
    let results = replies.subscriptions();
    let mut ids: Vec<&str> = results.context(Vehicle, "ego", Vehicle).map(|v| v.id()).collect();
    ids.sort_unstable();
    assert_eq!(ids, ["ego", "first", "second"], "the ego itself is among them");
    for car in results.context(Vehicle, "ego", Vehicle) {
        assert!(car.value(vehicle::POSITION_3D).unwrap().x < 200.0);
        assert!(["car", "DEFAULT_VEHTYPE"].contains(&car.str(vehicle::TYPE).unwrap()));
        assert!(car.value(vehicle::SPEED).unwrap() >= 0.0);
    }
    let people: Vec<&str> = results.context(Vehicle, "ego", Person).map(|p| p.id()).collect();
    assert_eq!(people, ["near"]);

    batch.clear();
    batch.unsubscribe_context(Vehicle, "ego", Person, 60.0);
    batch.subscribe_context(Vehicle, "ego", Vehicle, 60.0, &[vehicle::SPEED.id()]);
    batch.add_filter(&Filter::Lanes(&[0]));
    batch.add_filter(&Filter::LeadFollow);
    batch.add_filter(&Filter::DownstreamDistance(60.0));
    batch.add_filter(&Filter::UpstreamDistance(60.0));
    batch.add_filter(&Filter::NoOpposite);
    send(&mut client, &batch).await;
    let replies = client.step().await.unwrap();
    assert!(replies.subscriptions().context(Vehicle, "ego", Person).next().is_none());
    batch.clear();
    batch.unsubscribe_context(Vehicle, "ego", Vehicle, 60.0);
    batch.subscribe_context(Vehicle, "ego", Vehicle, 80.0, &[vehicle::SPEED.id()]);
    batch.add_filter(&Filter::VehicleClasses(&["bus"]));
    batch.add_filter(&Filter::VehicleTypes(&["none"]));
    send(&mut client, &batch).await;
    let replies = client.step().await.unwrap();
    assert_eq!(replies.subscriptions().context(Vehicle, "ego", Vehicle).count(), 0);
}

#[tokio::test]
async fn a_refused_subscription_is_an_error_in_its_own_slot() {
    let town = Town::new();
    let (_sumo, mut client) = town.launch().await;
    let mut batch = Batch::new();
    let unknown = batch.subscribe(Vehicle, "nobody", &[vehicle::SPEED.id()]);
    let infeasible =
        batch.subscribe_context(edge::Edge, "A1B1", TrafficLight, 100.0, &[traffic_light::STATE.id()]);
    let time = batch.get(simulation::TIME, "");
    batch.step();
    let replies = client.send(&batch).await.unwrap();
    assert!(replies.subscribed(unknown).unwrap_err().to_string().contains("nobody"));
    assert!(replies.subscribed(infeasible).unwrap_err().message.contains("nfeasible"));
    assert_eq!(replies.get(time).unwrap(), 0.0);
    assert_eq!(replies.failures().count(), 2);
}
