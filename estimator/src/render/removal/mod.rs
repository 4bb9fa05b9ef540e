//! Removal of objects. In: a segmented mesh and what is to go. Out: the vertices that go ([`select`]); a whole object is
//! found by the support it stands on ([`object_extraction`]).

pub mod object_extraction;
pub mod select;
