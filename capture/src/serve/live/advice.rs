//! What the user should do, from how far tracking is from being lost.

use fusion::Margin;

/// Below this margin there is advice.
const UNEASY: f32 = 0.6;
/// From these speeds on, motion is the likely cause of a small margin: metres and radians per second.
const FAST_M_S: f64 = 0.6;
const FAST_RAD_S: f64 = 1.2;
/// Depths outside of which the sensor measures little, metres.
const NEAR_M: f32 = 0.55;
const FAR_M: f32 = 3.0;

/// A frame, as far as advice depends on it.
#[derive(Debug, Clone, Copy)]
pub struct Observed {
    /// `None` for a frame that was not tracked from the one before.
    pub margin: Option<Margin>,
    /// True if the pose is known.
    pub tracked: bool,
    /// Speed of the camera, metres per second.
    pub speed_m_s: f64,
    /// Its angular speed, radians per second.
    pub turn_rad_s: f64,
    /// Median depth, metres; 0 without depth.
    pub median_depth_m: f32,
}

/// The smallest part of a margin, 0 to 1.
#[must_use]
pub fn least(m: &Margin) -> f32 {
    [m.fit, m.likeness, m.motion, m.structure, m.depth].into_iter().fold(1.0, f32::min)
}

/// What to do, if anything.
#[must_use]
pub fn advice(o: &Observed) -> Option<&'static str> {
    if !o.tracked {
        return Some("Lost: turn back to this view");
    }
    let m = o.margin?;
    let smallest = least(&m);
    if smallest >= UNEASY {
        return None;
    }
    let fast = o.speed_m_s > FAST_M_S || o.turn_rad_s > FAST_RAD_S;
    Some(match smallest {
        _ if fast || m.motion <= smallest => "Slower",
        _ if o.median_depth_m > 0.0 && o.median_depth_m < NEAR_M => "Too near: step back",
        _ if o.median_depth_m > FAR_M => "Too far: come closer",
        _ if m.depth <= smallest => "Little depth: show surfaces 0.5 to 3 m away",
        _ if m.structure <= smallest => "Nothing to hold on to: show an edge or a pattern",
        _ => "Turn back to where you were",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_names_the_cause() {
        let well = Margin { fit: 1.0, likeness: 1.0, motion: 1.0, structure: 1.0, depth: 1.0 };
        let observed = |m: Margin| Observed {
            margin: Some(m),
            tracked: true,
            speed_m_s: 0.1,
            turn_rad_s: 0.1,
            median_depth_m: 1.0,
        };
        assert_eq!(advice(&observed(well)), None);
        let of = |m: Margin| advice(&observed(m)).unwrap();
        assert!(of(Margin { motion: 0.2, ..well }).contains("Slower"));
        assert!(of(Margin { structure: 0.2, ..well }).contains("edge"));
        assert!(of(Margin { fit: 0.2, ..well }).contains("back to where"));
        assert!(of(Margin { depth: 0.2, ..well }).contains("depth"));
        let fit = Margin { fit: 0.2, ..well };
        assert!(advice(&Observed { speed_m_s: 1.0, ..observed(fit) }).unwrap().contains("Slower"));
        assert!(advice(&Observed { median_depth_m: 0.4, ..observed(fit) }).unwrap().contains("near"));
        assert!(advice(&Observed { tracked: false, margin: None, ..observed(well) }).unwrap().contains("Lost"));
    }
}
