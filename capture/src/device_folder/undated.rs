//! Scans that are made while the clock is not set. A box without a battery begins in 1970, or when its system was built, until it has
//! asked the network. Such a scan is named by its number alone, and its manifest says when it was made on the clock that counts from
//! the start of the system. Once the clock is set, name and manifest are put right; after a restart that is no longer possible, since
//! nothing tells how long the box was off.

use crate::device_folder::dates::{Moment, UNDATED, set_clock};
use crate::device_folder::naming::utc;
use crate::device_folder::{handed_off, manifest, retention};
use crate::failure::Failure;
use std::path::{Path, PathBuf};

/// Gives every scan that was published in this run of the system its date, if the clock is set, apart from those that `is_busy` (by
/// id) names and those that another machine holds under their name. Returns the old and the new folder of each; `None` while there may
/// be more to do.
pub fn put_right(device: &Path, is_busy: impl Fn(&str) -> bool) -> Option<Vec<(PathBuf, PathBuf)>> {
    set_clock()?;
    let mut changed = Vec::new();
    let mut is_done = true;
    for id in retention::published(device).into_iter().filter(|id| id.starts_with(&format!("{UNDATED}-"))) {
        let folder = device.join("scans").join(&id);
        if handed_off::is_confirmed(device, &folder) {
            continue;
        }
        if is_busy(&id) {
            is_done = false;
            continue;
        }
        match date(&folder) {
            Ok(Some(new)) => changed.push((folder, new)),
            Ok(None) => {}
            Err(e) => tracing::warn!("{e}"),
        }
    }
    is_done.then_some(changed)
}

/// Puts the date into the manifest, then into the name; a power cut between the two leaves the second to be done. `None` if the date
/// cannot be known.
fn date(folder: &Path) -> Result<Option<PathBuf>, Failure> {
    let Some(found) = manifest::read(folder) else { return Ok(None) };
    let began = match found["began"].as_str() {
        Some(began) => began.to_owned(),
        None => {
            let Ok(moments) = serde_json::from_value::<[Moment; 2]>(found["undated"].clone()) else { return Ok(None) };
            let [Some(began), Some(published)] = moments.map(|m| m.time().map(utc)) else { return Ok(None) };
            let dates = vec![("began", began.clone().into()), ("published", published.into()), ("undated", ().into())];
            manifest::change(folder, dates)?;
            began
        }
    };
    retention::set_stamp(folder, &began).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_are_dated_by_their_own_time() {
        let device = tempfile::tempdir().unwrap();
        let now = Moment::now();
        let ago = |s: f64| Moment { seconds: now.seconds - s, ..now.clone() };
        let lost = Moment { boot: "another".into(), ..now.clone() };
        let scan = |id: &str, moments: serde_json::Value| {
            let folder = device.path().join("scans").join(id);
            std::fs::create_dir_all(&folder).unwrap();
            manifest::change(&folder, vec![("undated", moments)]).unwrap();
        };
        let of = |moments: [Moment; 2]| serde_json::to_value(moments).unwrap();
        scan("undated-scan-0001-desk", of([ago(3600.0), ago(3500.0)]));
        scan("undated-scan-0002", of([lost.clone(), lost]));
        scan("undated-scan-0003", of([ago(60.0), ago(50.0)]));
        scan("undated-scan-0004", of([ago(30.0), ago(20.0)]));
        handed_off::confirm(device.path(), &device.path().join("scans/undated-scan-0004")).unwrap();
        assert_eq!(put_right(device.path(), |id| id.ends_with("0003")), None, "one is busy");
        let left = retention::published(device.path());
        let expected =
            [&utc(ago(3600.0).time().unwrap())[..11], "undated-scan-0002", "undated-scan-0003", "undated-scan-0004"];
        assert!(
            left.iter().zip(expected).all(|(a, b)| a.starts_with(b)) && left[0].ends_with("-scan-0001-desk"),
            "{left:?}"
        );
        let manifest = manifest::read(&device.path().join("scans").join(&left[0])).unwrap();
        assert!(
            left[0].starts_with(manifest["began"].as_str().unwrap()) && manifest["undated"].is_null(),
            "{manifest}"
        );
        assert!(manifest["published"].as_str() > manifest["began"].as_str(), "{manifest}");
        // The power was cut between manifest and name.
        scan("undated-scan-0005", serde_json::Value::Null);
        let cut = device.path().join("scans/undated-scan-0005");
        manifest::change(&cut, vec![("began", "20260301T000000Z".into())]).unwrap();
        assert_eq!(put_right(device.path(), |_| false).unwrap().len(), 2);
        assert!(device.path().join("scans/20260301T000000Z-scan-0005").exists());
        assert_eq!(put_right(device.path(), |_| false), Some(Vec::new()), "what is left has no date");
    }
}
