//! The picture a person looks at first.
