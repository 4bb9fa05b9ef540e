mod light;
mod near;
mod sensors;

use recordings::types::Intrinsics;

const SMALL: Intrinsics = Intrinsics { width: 64, height: 48, fx: 52.5, fy: 52.5, cx: 31.5, cy: 23.5 };
