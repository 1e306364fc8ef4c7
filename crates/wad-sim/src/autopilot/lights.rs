//! Traffic lights and stop signs: whether the next stop line may be crossed.

use super::junction::LinkPlan;
use super::params::AutopilotParams;
use super::speed::time_to_cover;
use sumo_network::network::{LinkId, Network};
use sumo_network::world::{SignalState, WorldState};

/// What a light requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Go; `yields`: vehicles with right of way go first.
    Go { yields: bool },
    /// Stand at the line.
    Stop,
}

/// Remembers what was decided at a yellow or red light, and stops made at a line.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lights {
    passing_yellow: Option<LinkId>,
    stopping_for: Option<LinkId>,
    stopped_at: Option<LinkId>,
}

impl Lights {
    /// Whether the line `distance` m before the front bumper, at which the ego waits for the light of `plan`, may be
    /// crossed at `speed` m/s.
    #[allow(clippy::too_many_arguments)]
    pub fn judge(
        &mut self,
        network: &Network,
        plan: &LinkPlan,
        world: &WorldState,
        distance: f64,
        speed: f64,
        top: f64,
        latency: f64,
        params: &AutopilotParams,
    ) -> Verdict {
        let link = network.link(plan.link);
        if speed < 0.3 && distance < 2.5 {
            self.stopped_at = Some(plan.link);
        }
        let by_rules = Verdict::Go { yields: !link.must_yield_to.is_empty() };
        let room = (distance - speed * latency).max(0.01);
        let needed = speed * speed / (2.0 * room);
        let Some(signal) = link.signal else {
            let must_stop = link.state == 's' && self.stopped_at != Some(plan.link);
            return if must_stop { Verdict::Stop } else { by_rules };
        };
        let state = world.signal(signal);
        let verdict = match state {
            None if distance < params.unknown_light_distance => Verdict::Stop,
            None => by_rules,
            Some(SignalState::Red | SignalState::RedYellow) => {
                // An ego that planned to stop brakes even if it is too late. Only an ego that the light
                // surprised drives on.
                let late = needed >= params.emergency_deceleration && speed >= 2.0;
                if late && self.stopping_for != Some(plan.link) {
                    by_rules
                } else {
                    self.stopping_for = Some(plan.link);
                    Verdict::Stop
                }
            }
            Some(SignalState::Yellow) => {
                if self.passing_yellow == Some(plan.link) {
                    by_rules
                } else {
                    let arrival = time_to_cover(distance, speed, 0.5, top.max(speed));
                    let late = arrival > params.yellow_time - 0.3;
                    let hardest =
                        if late { 0.8 * params.emergency_deceleration } else { params.yellow_deceleration };
                    if needed <= hardest || self.stopping_for == Some(plan.link) {
                        self.stopping_for = Some(plan.link);
                        Verdict::Stop
                    } else {
                        self.passing_yellow = Some(plan.link);
                        by_rules
                    }
                }
            }
            Some(SignalState::GreenMajor) => Verdict::Go { yields: false },
            Some(SignalState::GreenMinor | SignalState::Off) => by_rules,
            Some(SignalState::StopThenGo) => {
                if self.stopped_at == Some(plan.link) {
                    by_rules
                } else {
                    Verdict::Stop
                }
            }
        };
        if state != Some(SignalState::Yellow) && self.passing_yellow == Some(plan.link) {
            self.passing_yellow = None;
        }
        if matches!(verdict, Verdict::Go { .. }) && self.stopping_for == Some(plan.link) {
            self.stopping_for = None;
        }
        verdict
    }
}
