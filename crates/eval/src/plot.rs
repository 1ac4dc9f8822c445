//! Error against time, one point a method.

use drape_view::{
    Picture, ViewError,
    plot::{Cost, Family, trade_off},
};

use crate::table::{MM_10X_PER_METRE, Row};

/// Width of the picture in pixels.
const WIDTH: usize = 1000;
/// Height of the picture in pixels.
const HEIGHT: usize = 640;

/// Draws `methods` as single points and `engine` (one solver, several substep
/// counts) as a line. Rows that were not timed or not measured are left out.
///
/// # Errors
/// When no row can be drawn.
pub fn error_against_time(methods: &[Row], engine: &[Row]) -> Result<Picture, ViewError> {
    let families: Vec<Family> = [(false, methods), (true, engine)]
        .into_iter()
        .map(|(joined, rows)| Family {
            joined,
            costs: rows.iter().filter_map(cost).collect(),
        })
        .filter(|family| !family.costs.is_empty())
        .collect();
    trade_off(
        "What accuracy costs in time",
        "error over full rollouts, mm at the 10× scale",
        &families,
        WIDTH,
        HEIGHT,
    )
}

fn cost(row: &Row) -> Option<Cost> {
    Some(Cost {
        label: row.method.clone(),
        milliseconds: row.ms_per_frame?,
        error: row.summary.as_ref()?.overall.error_m?.mean * MM_10X_PER_METRE,
    })
}
