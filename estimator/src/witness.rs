//! How well frames that no step used are predicted.
