use super::*;

const LIMIT: f64 = 13.89;

fn p() -> RewardParams {
    RewardParams::default()
}

fn total(facts: &Facts) -> f64 {
    compute(&p(), facts).total()
}

/// Standing `distance` (m) before a red light.
fn at_red(distance: f64) -> Facts {
    Facts { light: Some(Light { distance, red: true }), ..Facts::cruising(0.0, LIMIT) }
}

/// Behind a vehicle.
fn behind(gap: f64, speed: f64, other: f64) -> Facts {
    let lead = Some(LeadState { gap, closing_speed: speed - other });
    Facts { lead, ..Facts::cruising(speed, LIMIT) }
}

#[test]
fn timeout_is_paid_once_and_only_for_blocking() {
    assert_eq!(timeout(&p(), false), 0.0);
    assert_eq!(timeout(&p(), true), -20.0);
    assert_eq!(compute(&p(), &at_red(3.0)).timeout, 0.0);
}

#[test]
fn collision_grows_with_the_impulse_up_to_its_bound() {
    assert_eq!(collision(&p(), None), 0.0);
    assert!((collision(&p(), Some(5000.0)) + 37.5).abs() < 1e-9);
    assert_eq!(collision(&p(), Some(1e9)), -50.0);
    assert!(collision(&p(), Some(300.0)) < -25.0);
}

#[test]
fn lane_is_earned_by_driving_inside_and_ever_worse_outside() {
    let at = |offset: f64, way: f64| lane(&p(), offset, false, way);
    assert_eq!((at(0.0, 1.0), at(0.0, 0.5), at(0.0, 0.0)), (0.2, 0.1, 0.0));
    assert!(at(0.89, 1.0) > 0.0);
    assert!(at(0.9, 1.0).abs() < 1e-9);
    for way in [0.0, 1.0] {
        let outside: Vec<f64> = [1.0, 1.3, 1.6, 1.75].iter().map(|&d| at(d, way)).collect();
        assert!(outside[0] < 0.0 && outside.windows(2).all(|w| w[1] < w[0]), "{outside:?}");
    }
    assert_eq!(at(4000.0, 1.0), -10.0, "far off the road it has an end");
    let gentle = collision(&p(), Some(0.0));
    assert!(lane(&p(), 1.8, true, 1.0) <= gentle, "off the road is no cheap way out of a collision");
}

#[test]
fn the_share_of_the_wanted_speed_ends_at_one_and_at_nothing() {
    let at = |speed: f64| way(&p(), &Facts::cruising(speed, 10.0));
    assert_eq!((at(-3.0), at(0.0), at(5.0), at(10.0), at(20.0)), (0.0, 0.0, 0.5, 1.0, 1.0));
    assert_eq!(way(&p(), &Facts { speed: 0.5, ..at_red(0.5) }), 0.5, "below walking pace");
}

#[test]
fn speed_punishes_slow_on_an_empty_road_and_fast_over_the_limit() {
    let at = |speed: f64| longitudinal(&p(), &Facts::cruising(speed, LIMIT));
    assert!((at(0.0) + 1.0).abs() < 1e-9);
    assert!((at(LIMIT) - 1.0).abs() < 1e-9);
    assert!(at(4.0) < 0.0 && at(8.0) > 0.0);
    assert!(at(LIMIT + 1.0) < at(LIMIT) && at(LIMIT + 3.0) < 0.0);
    assert_eq!(at(60.0), -1.5);
    assert!(at(-2.0) < 0.0);
}

#[test]
fn speed_punishes_fast_behind_a_vehicle_and_rewards_stopping_for_it() {
    assert!(longitudinal(&p(), &behind(4.0, 10.0, 0.0)) < -1.0, "fast towards a standing one");
    assert_eq!(longitudinal(&p(), &behind(5.0, 0.0, 0.0)), 0.45);
    assert!(longitudinal(&p(), &behind(20.0, 0.0, 0.0)) < 0.0, "no reason to stand 20 m behind it");
    assert!(longitudinal(&p(), &behind(14.0, 10.0, 10.0)) > 0.6, "following at its speed");
    assert!(longitudinal(&p(), &behind(3.0, 10.0, 10.0)) < 0.6, "too near at that speed");
    assert!(longitudinal(&p(), &behind(10.0, 0.0, 6.0)) < 0.0, "it has driven off");
}

#[test]
fn yellow_binds_only_where_the_ego_can_stop() {
    let at = |distance: f64, speed: f64| {
        let light = Some(Light { distance, red: false });
        longitudinal(&p(), &Facts { light, ..Facts::cruising(speed, LIMIT) })
    };
    assert!(at(8.0, 13.0) > 0.5, "too late to stop: drive on");
    assert!(at(29.0, 13.0) < 0.5, "it could stop and does not slow down");
}

#[test]
fn bends_lower_the_wanted_speed_in_time() {
    let bend = |distance: f64| curve_speed(&p(), [(distance, 1.0 / 10.0)]);
    assert!((bend(0.0) - 22f64.sqrt()).abs() < 1e-9);
    assert!(bend(30.0) > 10.0);
    assert_eq!(curve_speed(&p(), []), f64::INFINITY);
    let facts = Facts { curve_speed: bend(0.0), ..Facts::cruising(12.0, LIMIT) };
    assert!(longitudinal(&p(), &facts) < -1.0);
}

#[test]
fn oscillation_costs_and_a_bend_steered_as_it_needs_does_not() {
    let base = Facts::cruising(10.0, LIMIT);
    let bend = Facts { steer: 0.4, previous_steer: 0.4, curve_steer: 0.4, ..base };
    assert_eq!(smoothness(&p(), &bend), 0.0);
    let zigzag = Facts { steer: 0.2, previous_steer: -0.2, ..base };
    assert!((smoothness(&p(), &zigzag) + 0.05).abs() < 1e-9);
    let pedals = Facts { acceleration: 3.5, previous_acceleration: -4.5, ..base };
    assert!(smoothness(&p(), &pedals) < -0.09);
    assert_eq!(smoothness(&p(), &Facts { steer: 1.0, previous_steer: -1.0, ..pedals }), -0.1);
}

#[test]
fn running_a_red_light_costs_by_speed_and_standing_there_pays() {
    let run = |speed: f64| light(&p(), &Facts { ran_red: true, ..Facts::cruising(speed, LIMIT) });
    assert_eq!((run(0.0), run(10.0)), (-25.0, -35.0));
    assert_eq!(light(&p(), &at_red(3.0)), 0.15);
    assert_eq!(light(&p(), &at_red(15.0)), 0.0);
    let fast = Facts { speed: 13.0, ..at_red(5.0) };
    assert!(light(&p(), &fast) < -0.3);
    assert_eq!(light(&p(), &Facts { light: None, ..fast }), 0.0);
}

#[test]
fn driving_beats_waiting_beats_standing_beats_crashing() {
    // Discounted at gamma 0.98, from now on for ever.
    let for_ever = |facts: &Facts| 50.0 * total(facts);
    let drive = for_ever(&Facts::cruising(LIMIT, LIMIT));
    let wait = for_ever(&at_red(3.0));
    assert!(drive > wait && wait > 0.0, "{drive} {wait}");
    // In training standing without a reason ends after 4 s, 24 ticks.
    let idle = total(&Facts::cruising(0.0, LIMIT));
    let last = total(&Facts { blocked: true, ..Facts::cruising(0.0, LIMIT) });
    let stand = idle * (1.0 - 0.98_f64.powi(24)) / 0.02 + last * 0.98_f64.powi(24);
    // Worse than to begin to drive, however badly, and to leave the lane after 4 s of it.
    let slow = total(&Facts { offset: 0.8, ..Facts::cruising(0.3 * LIMIT, LIMIT) });
    let left = total(&Facts { left_road: true, offset: 1.8, ..Facts::cruising(0.3 * LIMIT, LIMIT) });
    let bad = slow * (1.0 - 0.98_f64.powi(24)) / 0.02 + left * 0.98_f64.powi(24);
    assert!(stand < bad && bad < 0.0, "{stand} {bad}");
    // What must be stood for is better stood for than run over.
    assert!(total(&Facts { collision: Some(250.0), ..Facts::cruising(1.0, LIMIT) }) < -20.0);
    assert!(total(&Facts { ran_red: true, ..Facts::cruising(5.0, LIMIT) }) < -20.0);
}

#[test]
fn terms_add_up_to_the_reward() {
    let facts = Facts { offset: 0.4, ..Facts::cruising(9.0, LIMIT) };
    let terms = compute(&p(), &facts);
    let by_name: f64 = terms.values().iter().sum();
    assert_eq!(terms.total(), by_name);
    assert_eq!(RewardTerms::NAMES.len(), terms.values().len());
    let mut sum = RewardTerms::default();
    sum.add(&terms);
    sum.add(&terms);
    assert!((sum.total() - 2.0 * terms.total()).abs() < 1e-12);
}
