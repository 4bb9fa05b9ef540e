//! What a removed object hid: its triangles are cut and the hole is closed ([`geometry`]); colour patterns are continued
//! from the border ([`texture`], on a [`membrane`]).

pub mod geometry;
pub mod membrane;
pub mod texture;
