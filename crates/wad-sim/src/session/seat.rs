//! An ego in a session: its vehicle, its criteria, and the expert that can drive it.

use super::{Act, Tick};
use crate::assets::Assets;
use crate::autopilot::{Autopilot, AutopilotParams, Decision, EgoModel, Told};
use crate::bridge::{Ego, Lamps};
use crate::criteria::{Criteria, CriteriaParams, Situation};
use sumo_network::network::{LanePosition, Network, RoadOption, Route};
use wad_vehicle::{Control, EgoParams};

/// Pressed further than this the brake pedal lights the brake lights.
const BRAKE_LIGHT: f64 = 0.05;

/// An ego with its criteria and its expert.
pub struct Seat {
    ego: Ego,
    criteria: Criteria,
    expert: Autopilot,
    /// The expert's decision for the next tick.
    decision: Option<Decision>,
    params: (AutopilotParams, CriteriaParams),
}

impl Seat {
    /// An ego called `id` in SUMO, standing at the begin of `route`.
    pub fn new(
        assets: &Assets,
        id: &str,
        vehicle: EgoParams,
        autopilot: AutopilotParams,
        criteria: CriteriaParams,
        route: Route,
    ) -> Self {
        let expert = Autopilot::new(autopilot, EgoModel::from(&vehicle));
        let mut ego = Ego::new(id, vehicle, route, 0.0);
        ego.vehicle_mut().set_statics(assets.statics().to_vec());
        Self { ego, criteria: Criteria::new(criteria), expert, decision: None, params: (autopilot, criteria) }
    }

    /// The ego.
    pub fn ego(&self) -> &Ego {
        &self.ego
    }

    /// The ego, mutable.
    pub fn ego_mut(&mut self) -> &mut Ego {
        &mut self.ego
    }

    /// Its criteria.
    pub fn criteria(&self) -> &Criteria {
        &self.criteria
    }

    /// Puts the ego down on `route` at `s` (m), standing, `left` of the route's line (m) and turned to the left
    /// by `turn` (rad). Expert and criteria start again.
    pub fn place(&mut self, route: Route, s: f64, (left, turn): (f64, f64)) {
        self.ego.respawn_beside(route, s, left, turn);
        self.begin();
    }

    /// Expert and criteria start again.
    pub fn begin(&mut self) {
        let (autopilot, criteria) = self.params;
        self.expert = Autopilot::new(autopilot, EgoModel::from(self.ego.params()));
        self.criteria = Criteria::new(criteria);
        self.decision = None;
    }

    /// Gives the ego a route that it is on at `s` (m), while it drives.
    pub fn set_route(&mut self, route: Route, s: f64) {
        self.ego.set_route(route, s);
        self.criteria.route_changed();
        self.expert.route_changed();
    }

    /// Gives the ego a `longer` route in place of its own: the destination stays where that one ended.
    pub fn lead_on(&mut self, longer: Route) {
        self.criteria.route_leads_on(self.ego.route().length());
        let s = self.ego.on_route().s;
        self.ego.set_route(longer, s);
    }

    /// Where the ego's destination lies on its route (m): the route may lead on behind it.
    pub fn destination_s(&self) -> f64 {
        self.criteria.destination().unwrap_or_else(|| self.ego.route().length())
    }

    /// The ego's destination.
    pub fn destination(&self) -> LanePosition {
        let route = self.ego.route();
        let before = self.criteria.destination().and(route.destinations.iter().nth_back(1));
        before.copied().unwrap_or(route.to)
    }

    /// Whether the expert has been asked since the last tick.
    pub fn is_planned(&self) -> bool {
        self.decision.is_some()
    }

    /// What the expert goes by too when it decides for the next tick ([`Autopilot::tell`]).
    pub fn tell(&mut self, told: Told) {
        self.expert.tell(told);
    }

    /// What the expert decides for the next tick of `tick` s.
    pub(super) fn plan(&mut self, network: &Network, tick: f64) -> Decision {
        let (ego, expert) = (&self.ego, &mut self.expert);
        *self.decision.get_or_insert_with(|| {
            let at = ego.on_route();
            expert.control(network, ego.route(), at.s, &at.state, ego.world(), tick)
        })
    }

    /// Lamps and physics of one tick of `tick` s.
    pub(super) fn drive(&mut self, act: Act, tick: f64) -> Tick {
        let decision = self.decision.take();
        if act == Act::Stay {
            let at = self.ego.on_route();
            let (contacts, events) = Default::default();
            return Tick {
                control: Control::default(),
                decision: None,
                before: at,
                after: at,
                contacts,
                events,
            };
        }
        let control = match (act, decision) {
            (Act::Control(control) | Act::Disturbed(control), _) => control,
            (Act::Expert, Some(decision)) => decision.control,
            (Act::Expert, None) | (Act::Stay, _) => Control::default(),
        }
        .clamped();
        let before = self.ego.on_route();
        let lamps = match (act, decision) {
            (Act::Expert | Act::Disturbed(_), Some(decision)) => Lamps {
                blinker_left: decision.blinker_left,
                blinker_right: decision.blinker_right,
                brake: decision.brake_light,
            },
            _ => lamps(&self.ego, &control),
        };
        self.ego.set_lamps(lamps);
        if decision.is_some_and(|decision| decision.control.clamped() != control) {
            self.expert.overruled();
        }
        let contacts = self.ego.advance(control, tick);
        Tick { control, decision, before, after: before, contacts, events: Vec::new() }
    }

    /// What happened, after SUMO's step.
    pub(super) fn judge(&mut self, network: &Network, duration: f64, tick: &mut Tick) {
        tick.after = self.ego.on_route();
        let params = self.ego.params();
        tick.events = self.criteria.check(&Situation {
            network,
            route: self.ego.route(),
            world: self.ego.previous_world(),
            before: tick.before,
            after: tick.after,
            contacts: &tick.contacts,
            static_label: &|key| self.ego.static_label(key),
            length: params.length,
            width: params.width,
            wheelbase: params.wheelbase,
            track: params.track,
            tick: duration,
        });
    }
}

/// What an ego shows whose driver has only pedals and a wheel: brake lights, and blinkers before a turn or a
/// lane change of its route.
fn lamps(ego: &Ego, control: &Control) -> Lamps {
    let at = ego.on_route();
    let ahead = (at.front_s + 2.0 + 2.0 * at.state.speed.max(0.0)).min(ego.route().length());
    let option = ego.route().at(ahead).option;
    Lamps {
        blinker_left: matches!(option, RoadOption::Left | RoadOption::ChangeLaneLeft),
        blinker_right: matches!(option, RoadOption::Right | RoadOption::ChangeLaneRight),
        brake: control.brake > BRAKE_LIGHT,
    }
}
