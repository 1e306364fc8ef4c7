//! Reachability of lanes from each other, for choosing destinations.

use super::{EdgeKind, LaneId, LinkDirection, Network, VehicleClass};

impl Network {
    /// The largest set of lanes of normal edges in which `class` can drive on from each to each, in
    /// file order: where random routes begin and end. Turn-arounds count only where the net is
    /// mostly dead ends, so that less than half of it is connected without them.
    pub fn largest_component(&self, class: VehicleClass) -> Vec<LaneId> {
        let without = self.component(class, false);
        let with = self.component(class, true);
        if 2 * without.len() < with.len() { with } else { without }
    }

    /// Lanes reached from `lane` directly: over its links, and by changing lanes.
    fn next_lanes(&self, lane: LaneId, class: VehicleClass, turn_around: bool) -> Vec<LaneId> {
        let here = self.lane(lane);
        let open = |l: LaneId| self.lane(l).permissions.allows(class);
        let mut next = Vec::new();
        if self.edge(here.edge).kind != EdgeKind::Normal {
            next.extend(here.incoming.iter().map(|&l| self.link(l).to).filter(|&l| open(l)));
            return next;
        }
        for &link in &here.outgoing {
            let link = self.link(link);
            if open(link.to)
                && link.via.iter().all(|&l| open(l))
                && (turn_around || link.direction != LinkDirection::TurnAround)
            {
                next.push(link.to);
            }
        }
        let lanes = &self.edge(here.edge).lanes;
        let beside =
            [(here.change_up, here.index.checked_add(1)), (here.change_down, here.index.checked_sub(1))];
        for (permission, index) in beside {
            if let Some(&other) = index.and_then(|i| lanes.get(i))
                && permission.allows(class)
                && open(other)
            {
                next.push(other);
            }
        }
        next
    }

    /// The largest strongly connected set of drivable lanes (Kosaraju's two searches).
    fn component(&self, class: VehicleClass, turn_around: bool) -> Vec<LaneId> {
        let lanes = self.drivable_lanes(class);
        let mut forward = vec![Vec::new(); self.lanes.len()];
        let mut backward = vec![Vec::new(); self.lanes.len()];
        for &lane in lanes {
            let next = self.next_lanes(lane, class, turn_around);
            next.iter().for_each(|n| backward[n.index()].push(lane));
            forward[lane.index()] = next;
        }
        // Lanes in the order in which the search forward is done with them.
        let mut order = Vec::with_capacity(lanes.len());
        let mut seen = vec![false; self.lanes.len()];
        for &root in lanes {
            if std::mem::replace(&mut seen[root.index()], true) {
                continue;
            }
            let mut stack = vec![(root, 0)];
            while let Some((lane, tried)) = stack.last_mut() {
                match forward[lane.index()].get(*tried) {
                    Some(&next) => {
                        *tried += 1;
                        if !std::mem::replace(&mut seen[next.index()], true) {
                            stack.push((next, 0));
                        }
                    }
                    None => {
                        order.push(*lane);
                        stack.pop();
                    }
                }
            }
        }
        let mut taken = vec![false; self.lanes.len()];
        let mut largest: Vec<LaneId> = Vec::new();
        for &root in order.iter().rev() {
            if std::mem::replace(&mut taken[root.index()], true) {
                continue;
            }
            let mut part = vec![root];
            let mut next = 0;
            while let Some(&lane) = part.get(next) {
                next += 1;
                for &other in &backward[lane.index()] {
                    if !std::mem::replace(&mut taken[other.index()], true) {
                        part.push(other);
                    }
                }
            }
            if part.len() > largest.len() {
                largest = part;
            }
        }
        largest.sort_unstable();
        largest
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::net;
    use super::*;

    #[test]
    fn the_ring_is_the_largest_component_and_the_dead_end_is_not_in_it() {
        let network = net();
        let names =
            |lanes: &[LaneId]| -> Vec<String> { lanes.iter().map(|&l| network.lane(l).id.clone()).collect() };
        let ring = network.largest_component(VehicleClass::Passenger);
        assert_eq!(names(&ring), ["ab_0", "ab_1", "bc_0", "bc_1", "ca_0"]);
        // A bicycle may not use bc_1, so that it stays on the outer lane.
        assert_eq!(
            names(&network.largest_component(VehicleClass::Bicycle)),
            ["ab_0", "ab_1", "bc_0", "ca_0"]
        );
    }
}
