//! Lamps and emitting surfaces changed on request: switched off, dimmed, recoloured, moved.

use crate::render::error::{RenderError, Result};
use glam::Vec3;
use recordings::local_light::LocalLight;

/// What a change looks like in text.
const FORM: &str = "must be N=off, N=on, N=*FACTOR, N=*R,G,B or N=@x,y,z; several for one lamp: N=*0.5,@x,y,z";

/// `N=CHANGE[,CHANGE…]`, where CHANGE is `off`, `on`, `*FACTOR`, `*R,G,B` or `@x,y,z`.
#[derive(Debug, Clone, PartialEq)]
pub struct LampChange {
    /// Number of the lamp in the result, from 0.
    pub number: usize,
    /// Factor on its radiance, linear RGB; 0 = off.
    pub factor: Vec3,
    /// New centre, world, in metres.
    pub center: Option<Vec3>,
}

impl std::str::FromStr for LampChange {
    type Err = String;
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (number, changes) = text.split_once('=').ok_or(FORM)?;
        let number = number.trim().parse().map_err(|_| format!("`{number}` is not the number of a lamp: {FORM}"))?;
        let mut change = Self { number, factor: Vec3::ONE, center: None };
        // Numbers belong to the sign before them.
        let mut parts: Vec<(char, Vec<f32>)> = Vec::new();
        for word in changes.split(',').map(str::trim) {
            let value = |text: &str| text.trim().parse().ok().filter(|x: &f32| x.is_finite()).ok_or(FORM);
            match (word, word.chars().next()) {
                ("off", _) => parts.push(('*', vec![0.0])),
                ("on", _) => parts.push(('*', vec![1.0])),
                (_, Some(sign @ ('*' | '@'))) => parts.push((sign, vec![value(&word[1..])?])),
                _ => parts.last_mut().ok_or(FORM)?.1.push(value(word)?),
            }
        }
        for (sign, numbers) in parts {
            match (sign, numbers.as_slice()) {
                ('*', [factor]) => change.factor *= Vec3::splat(*factor),
                ('*', [r, g, b]) => change.factor *= Vec3::new(*r, *g, *b),
                ('@', [x, y, z]) => change.center = Some(Vec3::new(*x, *y, *z)),
                _ => return Err(FORM.into()),
            }
        }
        if change.factor.min_element() < 0.0 {
            return Err("a lamp's factor must not be negative".into());
        }
        Ok(change)
    }
}

/// A light whose lamps and emitting surfaces are changed. What no change names stays as scanned, or is off if `others_off`.
///
/// # Errors
/// A change names what the result does not have, or moves a surface.
pub fn changed_light(
    light: &LocalLight,
    lamps: &[LampChange],
    emitters: &[LampChange],
    others_off: bool,
) -> Result<LocalLight> {
    let mut changed = light.clone();
    let (have_lamps, have_emitters) = (changed.lamps.iter_mut(), changed.emitters.iter_mut());
    let mut lamp_radiance: Vec<&mut [f64; 3]> = have_lamps.map(|l| &mut l.radiance).collect();
    scale("lamp", &mut lamp_radiance, lamps, others_off)?;
    scale("emitter", &mut have_emitters.map(|e| &mut e.radiance).collect::<Vec<_>>(), emitters, others_off)?;
    if emitters.iter().any(|e| e.center.is_some()) {
        return Err(RenderError::Request(
            "--emitter: a surface cannot be moved; it can be switched off and dimmed".into(),
        ));
    }
    for (number, center) in lamps.iter().filter_map(|c| Some((c.number, c.center?))) {
        changed.lamps[number].center = center.to_array();
    }
    Ok(changed)
}

fn scale(kind: &str, radiance: &mut [&mut [f64; 3]], changes: &[LampChange], others_off: bool) -> Result<()> {
    let count = radiance.len();
    if let Some(change) = changes.iter().find(|c| c.number >= count) {
        let have = match count {
            0 => format!("the result has no {kind}s (`lumiscan inspect` prints its light model)"),
            1 => format!("the result has one, {kind} 0"),
            _ => format!("the result has {kind}s 0 to {}", count - 1),
        };
        return Err(RenderError::Request(format!("--{kind}: there is no {kind} {}: {have}", change.number)));
    }
    for (number, radiance) in radiance.iter_mut().enumerate() {
        let mut of = changes.iter().filter(|c| c.number == number).peekable();
        let untouched = if others_off && of.peek().is_none() { Vec3::ZERO } else { Vec3::ONE };
        let factor = of.fold(untouched, |f, c| f * c.factor);
        (0..3).for_each(|c| radiance[c] *= f64::from(factor[c]));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use recordings::local_light::{Emitter, Lamp};

    fn read(text: &str) -> std::result::Result<LampChange, String> {
        text.parse()
    }

    #[test]
    fn every_form_is_read() {
        let change = |factor: Vec3, center| LampChange { number: 1, factor, center };
        assert_eq!(read("1=off"), Ok(change(Vec3::ZERO, None)));
        assert_eq!(read("1=on"), Ok(change(Vec3::ONE, None)));
        assert_eq!(read("1=*0.5"), Ok(change(Vec3::splat(0.5), None)));
        assert_eq!(read("1=*1,0.5,0.2"), Ok(change(Vec3::new(1.0, 0.5, 0.2), None)));
        let place = Some(Vec3::new(-1.0, 2.0, 0.5));
        assert_eq!(read("1=@-1,2,0.5"), Ok(change(Vec3::ONE, place)));
        assert_eq!(read("1=*1,0.5,0.2, @-1, 2,0.5,*2"), Ok(change(Vec3::new(2.0, 1.0, 0.4), place)));
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        for text in ["", "1", "=off", "x=off", "-1=off", "1=", "1=half", "1=0.5", "1=*", "1=*1,2", "1=@1,2", "1=*nan"] {
            assert!(read(text).is_err(), "{text}");
        }
        assert!(read("1=*-1").is_err() && read("1=@1,2,3,4").is_err() && read("1=off,0.5").is_err());
    }

    #[test]
    fn a_light_is_changed_by_number() {
        let lamp = |x: f32| Lamp { center: [x, 0.0, 0.0], radius_m: 0.1, radiance: [4.0, 2.0, 1.0] };
        let emitter = Emitter { vertices: vec![0], radiance: [8.0; 3] };
        let light = LocalLight { lamps: vec![lamp(0.0), lamp(1.0)], emitters: vec![emitter], ..LocalLight::default() };
        let changes = [read("1=*0.5,@3,2,1").unwrap()];
        let changed = changed_light(&light, &changes, &[], false).unwrap();
        assert_eq!((changed.lamps[1].radiance, changed.lamps[1].center), ([2.0, 1.0, 0.5], [3.0, 2.0, 1.0]));
        assert_eq!((changed.lamps[0], &changed.emitters), (lamp(0.0), &light.emitters));
        let alone = changed_light(&light, &changes, &[], true).unwrap();
        assert_eq!((alone.lamps[0].radiance, alone.emitters[0].radiance), ([0.0; 3], [0.0; 3]));
        assert_eq!(alone.lamps[1], changed.lamps[1]);

        let refused = |lamps: &[&str], emitters: &[&str]| {
            let all = |texts: &[&str]| texts.iter().map(|t| read(t).unwrap()).collect::<Vec<_>>();
            changed_light(&light, &all(lamps), &all(emitters), false).unwrap_err().to_string()
        };
        assert!(refused(&["2=off"], &[]).contains("lamps 0 to 1"));
        assert!(refused(&[], &["1=off"]).contains("emitter 0"));
        assert!(refused(&[], &["0=@1,2,3"]).contains("cannot be moved"));
        let none = changed_light(&LocalLight::default(), &changes, &[], false).unwrap_err().to_string();
        assert!(none.contains("no lamps"), "{none}");
    }
}
