//! sumo-gui's views. The first one is called [`MAIN_VIEW`].

use crate::types::Position2D;
use crate::{Batch, Query, Ticket, Variable};

domain!(
    /// The GUI domain: only sumo-gui has it.
    Gui, "gui", 0xac
);

/// Id of sumo-gui's first view.
pub const MAIN_VIEW: &str = "View #0";

variables! { Gui:
    /// Percent.
    ZOOM: f64 = 0xa0;
    /// Centre of the view.
    OFFSET: Position2D = 0xa1;
    /// Name of the view's colour scheme.
    SCHEMA: String = 0xa2;
    /// Degrees.
    ANGLE: f64 = 0x43;
    /// Lower left and upper right corner.
    BOUNDARY: Vec<Position2D> = 0xa3;
    /// Whether there is such a view.
    HAS_VIEW: bool = 0xa7;
    /// Id of the vehicle that the view follows.
    TRACKED_VEHICLE: String = 0xa6;
}

setters! { Gui:
    SET_ZOOM: f64 = 0xa0;
    SET_OFFSET: Position2D = 0xa1;
    SET_SCHEMA: String = 0xa2;
    SET_ANGLE: f64 = 0x43;
    SET_BOUNDARY: Vec<Position2D> = 0xa3;
    /// Vehicle id; "" ends it.
    TRACK_VEHICLE: String = 0xa6;
    /// On an object's id, with its kind ("vehicle"): selects it, or not any more.
    TOGGLE_SELECTION: String = 0xa4;
}

/// Whether the object with this id and of this kind ("vehicle") is selected.
pub const fn is_selected(kind: &str) -> Query<Gui, bool, &str> {
    Variable::new(0xa4, "is_selected").with(kind)
}

/// Writes the view to an image file at the next step; -1 for the view's own size (pixels).
pub fn screenshot(batch: &mut Batch, view: &str, file: &str, width: i32, height: i32) -> Ticket<()> {
    batch.set_raw(Gui, 0xa5, "screenshot", view, (file, width, height))
}

/// Opens another view.
pub fn add_view(batch: &mut Batch, view: &str, scheme: &str, in_3d: bool) -> Ticket<()> {
    batch.set_raw(Gui, 0x80, "add_view", view, (scheme, i32::from(in_3d)))
}

/// Closes a view.
pub fn remove_view(batch: &mut Batch, view: &str) -> Ticket<()> {
    batch.set_bare(Gui, 0x81, "remove_view", view)
}
