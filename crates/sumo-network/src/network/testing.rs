//! A small net, written by hand, for the unit tests.
//!
//! Road `ab` (two lanes, east) leads to a junction `B` where lane 0 goes on to `bc` or right to `br`,
//! and lane 1 on to `bc` or left to `bl`. `bc` ends in `ca`, which leads round to `ab` again. There
//! are no internal lanes.

use super::*;
use std::path::Path;

/// The net's text, with lane `ab_0`'s further attributes.
pub fn text(ab_0: &str) -> String {
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<net version="1.20">
  <location netOffset="0,0" convBoundary="0,0,1,1" origBoundary="0,0,1,1" projParameter="!"/>
  <edge id="ab" from="A" to="B" priority="2" name="Main Street &amp; Co">
    <lane id="ab_0" index="0" {ab_0} speed="10" length="290" shape="0,-4.8 290,-4.8"/>
    <lane id="ab_1" index="1" speed="10" length="290" shape="0,-1.6 290,-1.6"/>
  </edge>
  <edge id="bc" from="B" to="C"><lane id="bc_0" index="0" speed="10" length="290" shape="310,-4.8 600,-4.8"/>
    <lane id="bc_1" index="1" disallow="bicycle" speed="10" length="580" shape="310,-1.6 600,-1.6"/></edge>
  <edge id="bl" from="B" to="L"><lane id="bl_0" index="0" speed="10" length="290" width="3" shape="301.6,10 301.6,300"/></edge>
  <edge id="br" from="B" to="R"><lane id="br_0" index="0" allow="bus" speed="10" length="290" shape="298.4,-10 298.4,-300"/></edge>
  <edge id="ca" from="C" to="A"><lane id="ca_0" index="0" speed="10" length="960" shape="610,-4.8 650,-4.8 650,100 -50,100 -50,-4.8 -10,-4.8"/></edge>
  <tlLogic id="light" type="static" programID="0" offset="0"><phase duration="9" state="GrG"/></tlLogic>
  <junction id="A" type="priority" x="0" y="0" incLanes="ca_0" intLanes="" shape="0,0 0,-6"><request index="0" response="0" foes="0"/></junction>
  <junction id="B" type="traffic_light" x="300" y="0" incLanes="ab_0 ab_1" intLanes="" shape="290,0 290,-6">
    <request index="0" response="0000" foes="1000"/><request index="1" response="0000" foes="0000"/>
    <request index="2" response="0000" foes="0000"/><request index="3" response="0001" foes="0001"/></junction>
  <junction id="C" type="priority" x="600" y="0" incLanes="bc_0" intLanes="" shape="600,0 600,-6"/>
  <junction id="L" type="dead_end" x="300" y="300" incLanes="bl_0" intLanes="" shape=""/>
  <junction id="R" type="dead_end" x="300" y="-300" incLanes="br_0" intLanes="" shape=""/>
  <connection from="ab" to="bc" fromLane="0" toLane="0" tl="light" linkIndex="0" dir="s" state="o"/>
  <connection from="ab" to="br" fromLane="0" toLane="0" dir="r" state="M"/>
  <connection from="ab" to="bc" fromLane="1" toLane="1" tl="light" linkIndex="1" dir="s" state="o"/>
  <connection from="ab" to="bl" fromLane="1" toLane="0" tl="light" linkIndex="2" dir="l" state="o"/>
  <connection from="bc" to="ca" fromLane="0" toLane="0" dir="s" state="M"/>
  <connection from="ca" to="ab" fromLane="0" toLane="0" dir="s" state="M"/>
</net>"#
    )
}

/// The net.
pub fn net() -> Network {
    parsed(&text("")).unwrap()
}

/// A net from text, called `test.net.xml`.
pub fn parsed(text: &str) -> Result<Network, NetworkError> {
    Network::from_xml(Path::new("test.net.xml"), text)
}

/// A place by SUMO's lane id and arc length (m).
pub fn place(network: &Network, lane: &str, s: f64) -> LanePosition {
    LanePosition { lane: network.lane_by_id(lane).unwrap(), s }
}
