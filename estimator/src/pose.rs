//! Pose refinement by Lucas–Kanade against the re-rendered keyframe.
