//! Mesh regularisation.
