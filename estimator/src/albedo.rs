//! Albedo in detail.
