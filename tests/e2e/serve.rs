//! The web page: who may open it, what it shows while a recording is played or a simulated Kinect scans, what it does with
//! finished scans, and what strangers can do to it. A scan is the same whether it is watched or not.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "these are tests")]

mod common;

use common::http::{Reply, Served};
use common::{arg, ok, tum_folder};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The recording that comes with the repository: 5.5 s of a table.
fn recording() -> String {
    arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data/tabletop.lrec"))
}

/// A watched replay of the synthetic table, about one second long.
fn watched_table(folder: &Path, more: &[&str]) -> Served {
    let (source, device) = (folder.join("table"), arg(folder.join("device")));
    tum_folder(&source, 30);
    let source = arg(source);
    let fixed = ["replay", &source, "--device", &device, "--watch=127.0.0.1:0", "--set", "fusion.voxel_size_m=0.01"];
    Served::start(folder, &[&fixed[..], more].concat())
}

/// A daemon with a simulated Kinect that shows the recording; its last picture stands.
fn daemon(folder: &Path, more: &[&str]) -> Served {
    let (device, plan) = (arg(folder.join("device")), recording());
    let fixed = [
        "capture",
        "--device",
        &device,
        "--simulate",
        &plan,
        "--serve",
        "127.0.0.1:0",
        "--set",
        "daemon.min_free_mb=1",
    ];
    Served::start(folder, &[&fixed[..], more].concat())
}

#[test]
fn only_those_who_are_paired_see_anything() {
    let folder = tempfile::tempdir().unwrap();
    let s = watched_table(folder.path(), &["--keep", "--no-estimate"]);
    let stranger = |method: &str, path: &str| s.ask(method, path, "", "");
    for path in ["/scans", "/api/status", "/live.js", "/api/live.mjpeg", "/scans/x/scan.lscan", "/nothing"] {
        assert_eq!(stranger("GET", path).status, 401, "{path}");
    }
    assert_eq!(stranger("POST", "/api/scan/start").status, 401);
    let page = stranger("GET", "/");
    assert!(page.status == 401 && page.text().contains("Pair") && !page.text().contains("<script"));

    // A guess costs time; the code works once.
    let began = Instant::now();
    assert_eq!(stranger("GET", "/?code=abcdefghijkm").status, 403);
    assert_eq!(s.ask("GET", "/api/status", "Authorization: Bearer x\r\n", "").status, 401);
    assert!(began.elapsed() >= Duration::from_secs(2));
    // Of many at once, one waits for its answer and holds a connection; the others are told to come back.
    let began = Instant::now();
    let mut answers: Vec<u16> = std::thread::scope(|scope| {
        let guesses: Vec<_> =
            (0..6).map(|_| scope.spawn(|| s.ask("GET", "/?code=abcdefghijkm", "", "").status)).collect();
        guesses.into_iter().map(|g| g.join().unwrap()).collect()
    });
    answers.sort_unstable();
    let looked_at = answers.iter().take_while(|a| **a == 403).count();
    assert!(looked_at >= 1 && answers[looked_at..].iter().all(|a| *a == 429), "{answers:?}");
    let costs = Duration::from_secs(looked_at as u64);
    assert!(looked_at < 6 && began.elapsed() >= costs, "{looked_at} in {:?}", began.elapsed());
    let pairing = format!("/?code={}", s.code);
    assert_eq!(stranger("HEAD", &pairing).status, 401, "a preview of the address does not use it up");
    let paired = stranger("GET", &pairing);
    assert_eq!((paired.status, paired.headers["location"].as_str()), (303, "/"));
    let set = &paired.headers["set-cookie"];
    assert!(set.contains("HttpOnly") && set.contains("SameSite"), "{set}");
    assert_eq!(stranger("GET", &pairing).status, 403);

    let cookie = format!("Cookie: {}\r\n", set.split(';').next().unwrap());
    let page = s.ask("GET", "/", &cookie, "");
    let policy = &page.headers["content-security-policy"];
    assert!(page.status == 200 && policy.contains("script-src 'self'") && !policy.contains("unsafe"), "{policy}");

    // A browser's changes come from pages of ours, under a name of ours.
    let order = |more: &str| s.ask("POST", "/api/scan/resume", &format!("{cookie}{more}"), "").status;
    assert_eq!(order(""), 403);
    assert_eq!(order("Origin: http://evil.example\r\n"), 403);
    assert_ne!(order(&format!("Origin: http://{}\r\n", s.host)), 403);
    let other_name = format!("GET /api/status HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n{cookie}\r\n");
    assert_eq!(s.raw(other_name.as_bytes()).status, 421);

    // Nothing outside of the scans is a file.
    for path in [
        "/scans/../token",
        "/scans/..%2f..%2ftoken",
        "/scans/%2e%2e/token",
        "//etc/passwd",
        "/scans/x/%00",
        "/etc/passwd",
    ] {
        let status = s.get(path).status;
        assert!(status == 404 || status == 400, "{path}: {status}");
    }
    assert!(!s.log().contains("panicked"), "{}", s.log());
}

/// Reads pictures and surface until it is told to stop; returns how many pictures came.
fn client(s: &Served, over: &AtomicBool) -> usize {
    let (mut last, mut seen, mut since) = (0u64, 0, (0u32, 0u64));
    while !over.load(Ordering::Relaxed) {
        let r = s.get(&format!("/api/live.jpg?after={last}"));
        if r.status == 200 && r.body.starts_with(&[0xff, 0xd8]) {
            (last, seen) = (r.headers["x-number"].parse().unwrap(), seen + 1);
        }
        let surface = s.get(&format!("/api/surface?generation={}&since={}", since.0, since.1)).body;
        if surface.len() >= 24 {
            since.0 = u32::from_le_bytes(surface[4..8].try_into().unwrap());
            since.1 = u64::from_le_bytes(surface[8..16].try_into().unwrap());
        }
    }
    seen
}

#[test]
fn a_scan_is_the_same_whether_it_is_watched_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let quiet = folder.path().join("quiet");
    let unwatched =
        PathBuf::from(ok(&["replay", &recording(), "--device", &arg(&quiet), "--no-estimate"]).trim().to_owned());
    let device = arg(folder.path().join("watched"));
    let mut s = Served::start(
        folder.path(),
        &["replay", &recording(), "--device", &device, "--watch", "--keep", "--no-estimate"],
    );
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let clients = [scope.spawn(|| client(&s, &over)), scope.spawn(|| client(&s, &over))];
        // One more that takes a kilobyte a second.
        scope.spawn(|| s.read_slowly("/api/live.mjpeg", &over));
        let began = Instant::now();
        while s.get("/api/status").json()["state"] != "done" {
            assert!(began.elapsed() < Duration::from_secs(240), "{}", s.log());
            std::thread::sleep(Duration::from_millis(100));
        }
        over.store(true, Ordering::Relaxed);
        for client in clients {
            assert!(client.join().unwrap() > 5, "pictures move");
        }
    });
    let status = s.wait("published", |s| s["last_scan"].is_string());
    let folder = PathBuf::from(status["last_scan"].as_str().unwrap());
    assert_eq!(status["live"]["losses"], 0);
    for file in ["scan.lscan", "trajectory.txt"] {
        assert!(std::fs::read(folder.join(file)).unwrap() == std::fs::read(unwatched.join(file)).unwrap(), "{file}");
    }
    s.signal("-INT");
    assert_eq!(s.ended().0, Some(0));
}

#[test]
fn a_scan_is_driven_from_the_page_and_its_files_are_fetched() {
    let folder = tempfile::tempdir().unwrap();
    let mut s = daemon(folder.path(), &["--no-estimate"]);
    s.wait("ready", |s| s["state"] == "ready");
    assert_eq!(s.post("/api/scan/pause", "").status, 409);
    assert_eq!(s.post("/api/scan/start", "").status, 200);
    s.wait("tracking", |s| s["live"]["tracking"] == "tracked" && s["live"]["blocks"][0].as_u64() > Some(100));

    // While someone watches, the light so far is estimated.
    assert_eq!(s.get("/api/light").status, 404);
    let began = Instant::now();
    while s.get("/api/light").status != 200 {
        assert!(s.get("/api/surface").body.len() >= 24 && began.elapsed() < Duration::from_secs(240), "{}", s.log());
        std::thread::sleep(Duration::from_millis(100));
    }
    let light = s.get("/api/light").json();
    let told: Vec<f64> = serde_json::from_value(light["told"].clone()).unwrap();
    assert!(light["coefficients"].as_array().is_some_and(|c| c.len() == 25) && light["vertices"].as_u64() > Some(100));
    assert!(told.contains(&1.0) && told.contains(&0.0), "a table tells of the light from above");

    // While paused, the camera is tracked and nothing is added.
    s.post("/api/scan/pause", "");
    let paused = s.wait("paused", |s| s["live"]["paused"] == true);
    let (blocks, fused) = (paused["live"]["blocks"].clone(), paused["scan"]["fused_pairs"].as_u64());
    let later = s.wait("later", |s| s["scan"]["fused_pairs"].as_u64() > fused.map(|n| n + 10));
    assert_eq!((&later["live"]["blocks"], &later["live"]["tracking"]), (&blocks, &"tracked".into()));
    s.post("/api/scan/resume", "");
    s.wait("resumed", |s| s["live"]["paused"] == false);
    assert_eq!(s.post("/api/scan/name", "{\"name\": \"my desk\"}").status, 200);
    assert_eq!(s.post("/api/scan/name", "{\"name\": \"\"}").status, 400);
    s.wait("two seconds", |s| s["scan"]["seconds"].as_f64() > Some(2.0));
    s.post("/api/scan/stop", "");
    s.wait("published", |s| s["finished_scans"] == 1 && s["state"] == "ready");

    // Some settings change while the box runs: the next scan has them.
    let change = |body: &str| s.post("/api/settings", body);
    for body in ["{\"settings\": {\"fusion.pool_blocks\": 512}}", "{\"settings\": {\"fusion.voxel_size_m\": 9}}", "[]"]
    {
        assert_eq!(change(body).status, 400, "{body}");
    }
    assert_eq!(change("{\"settings\": {\"fusion.voxel_size_m\": 0.031}}").status, 200);
    let settings = s.get("/api/settings").json();
    let changed = settings["settings"].as_array().unwrap().iter().find(|s| s["key"] == "fusion.voxel_size_m").unwrap();
    assert_eq!((&changed["value"], &changed["changes"]), (&"0.031".into(), &true.into()));
    assert_eq!(change("{\"settings\": {\"daemon.max_scan_s\": 77}}").status, 200);
    assert_eq!(s.get("/api/status").json()["max_scan_s"], 77.0, "the page shows the limit that holds now");

    let list = s.get("/api/scans").json();
    let (id, name) = (list["scans"][0]["id"].as_str().unwrap().to_owned(), &list["scans"][0]["name"]);
    assert!(id.ends_with("-scan-0001-my_desk") && name == "my desk", "{list}");
    let on_disk = std::fs::read(folder.path().join("device/scans").join(&id).join("scan.lscan")).unwrap();
    let path = format!("/scans/{id}/scan.lscan");
    let whole = s.get(&path);
    assert!(whole.status == 200 && whole.body == on_disk);
    let part = |range: &str, more: &str| s.ask("GET", &path, &format!("{}Range: {range}\r\n{more}", s.access), "");
    let tail = part("bytes=1000-", "");
    assert!(tail.status == 206 && tail.body == on_disk[1000..]);
    let stale = part("bytes=1000-", "If-Range: \"other\"\r\n");
    assert!(stale.status == 200 && stale.body == on_disk, "what has changed is sent anew");
    assert_eq!(part("bytes=99999999999-", "").status, 416);

    // Links lead nowhere, whether they stand for a file or a scan.
    let scans = folder.path().join("device/scans");
    std::os::unix::fs::symlink("/etc/passwd", scans.join(&id).join("passwd.txt")).unwrap();
    std::os::unix::fs::symlink("/etc", scans.join("elsewhere")).unwrap();
    for linked in [format!("/scans/{id}/passwd.txt"), "/scans/elsewhere/passwd".into(), "/scans/elsewhere.tar".into()] {
        assert_eq!(s.get(&linked).status, 404, "{linked}");
    }

    // An archive that broke off goes on where it broke off, and `tar` reads it.
    let archive = format!("/scans/{id}.tar");
    let whole = s.get(&archive);
    let cut = whole.body.len() / 3;
    let rest = s.ask("GET", &archive, &format!("{}Range: bytes={cut}-\r\n", s.access), "");
    assert_eq!((rest.status, [&whole.body[..cut], &rest.body].concat() == whole.body), (206, true));
    let file = folder.path().join("x.tar");
    std::fs::write(&file, &whole.body).unwrap();
    assert!(Command::new("tar").args(["-xf", &arg(&file), "-C", &arg(folder.path())]).status().unwrap().success());
    assert_eq!(std::fs::read(folder.path().join(&id).join("scan.lscan")).unwrap(), on_disk);

    // A discarded scan is not published; a renamed one keeps its number; a deleted one is gone.
    s.post("/api/scan/start", "");
    s.wait("scanning", |s| s["scan"]["seconds"].as_f64() > Some(0.5));
    // Half of it while the scene is small.
    let voxel = s.get("/api/status").json()["live"]["voxel_size_m"].as_f64().unwrap();
    assert!((voxel - 0.031).abs() < 1e-6 || (voxel - 0.0155).abs() < 1e-6, "{voxel}");
    s.post("/api/scan/discard", "");
    s.wait("ready again", |s| s["state"] == "ready");
    assert_eq!(s.get("/api/scans").json()["scans"].as_array().unwrap().len(), 1);
    let renamed =
        s.post(&format!("/api/scans/{id}/name"), "{\"name\": \"kitchen\"}").json()["id"].as_str().unwrap().to_owned();
    assert!(renamed.ends_with("-scan-0001-kitchen"), "{renamed}");
    assert_eq!(s.get(&path).status, 404);
    assert_eq!(s.ask("DELETE", &format!("/api/scans/{renamed}"), &s.access, "").status, 200);
    assert_eq!(s.get("/api/scans").json()["scans"], serde_json::json!([]));
    s.signal("-TERM");
    assert_eq!(s.ended().0, Some(0));
}

#[test]
fn the_lines_of_the_description_work() {
    if !Command::new("curl").arg("--version").output().is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: curl is not on the PATH");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut s = daemon(folder.path(), &["--no-estimate"]);
    s.wait("ready", |s| s["state"] == "ready");
    s.post("/api/scan/start", "");
    s.wait("tracking", |s| s["live"]["tracking"] == "tracked" && s["scan"]["seconds"].as_f64() > Some(1.0));
    std::fs::write(folder.path().join("object.ply"), "ply\n").unwrap();
    let described = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("API.md")).unwrap();
    let mut lines = 0;
    let mut id = String::new();
    for line in described.lines().filter_map(|l| l.strip_prefix("    curl ")) {
        if line.contains("$ID") && id.is_empty() {
            s.wait("published", |s| s["finished_scans"] == 1 && s["state"] == "ready");
            id = s.get("/api/scans").json()["scans"][0]["id"].as_str().unwrap().to_owned();
        }
        let token = s.access.trim().trim_start_matches("Authorization: Bearer ").to_owned();
        let output = Command::new("bash")
            .args(["-c", &format!("curl --fail-with-body {line}")])
            .current_dir(folder.path())
            .envs([("TOKEN", token), ("BOX", format!("http://{}", s.host)), ("ID", id.clone())])
            .output()
            .unwrap();
        let said = common::text(&output.stdout);
        assert!(
            output.status.success() && !said.contains("\"error\""),
            "{line}: {said}{}",
            common::text(&output.stderr)
        );
        lines += 1;
    }
    assert!(lines > 15, "the lines were found");
    let pictures = std::fs::read(folder.path().join("live.mjpeg")).unwrap();
    assert!(pictures.starts_with(b"--lumiscan-picture\r\nContent-Type: image/jpeg"));
    assert!(std::fs::read(folder.path().join("live.jpg")).unwrap().windows(2).any(|w| w == [0xff, 0xd8]));
    assert!(std::fs::read(folder.path().join("surface.bin")).unwrap().starts_with(b"LSRF"));
}

#[test]
fn strangers_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut s = daemon(folder.path(), &["--no-estimate"]);
    s.wait("ready", |s| s["state"] == "ready");
    s.post("/api/scan/start", "");
    s.wait("tracking", |s| s["scan"]["seconds"].as_f64() > Some(0.5));
    let before = s.memory();
    // Connections that stall: in the head, in the body, without a byte, and without reading.
    let stalls: Vec<_> = (0..200)
        .map(|i| {
            let mut stream = s.connect();
            let text = ["GET /api/sta", "", "POST /api/pair HTTP/1.1\r\nContent-Length: 9\r\n\r\nab", "GET /a"][i % 4];
            let _ = stream.write_all(text.as_bytes());
            stream
        })
        .collect();
    let fused = s.wait("a stalled connection gives way", |s| s["state"] == "scanning")["scan"]["fused_pairs"].as_u64();
    s.wait("the scan goes on", |s| s["scan"]["fused_pairs"].as_u64() > fused.map(|n| n + 15));
    drop(stalls);

    // Malformed requests, seeded. LUMISCAN_REQUESTS=20000 sends more.
    let requests = std::env::var("LUMISCAN_REQUESTS").ok().and_then(|n| n.parse().ok()).unwrap_or(1500u64);
    let good =
        format!("GET /scans/%2e%2e/x?a=b HTTP/1.1\r\nHost: {}\r\nContent-Length: 4\r\n\r\nabcd", s.host).into_bytes();
    let mut seed = 1u64;
    let mut random = |n: usize| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as usize % n
    };
    for _ in 0..requests {
        let mut bytes = good.clone();
        for _ in 0..1 + random(6) {
            let at = random(bytes.len());
            match random(3) {
                0 => bytes[at] = random(256) as u8,
                1 => bytes.truncate(at + 1),
                _ => bytes.insert(at, random(256) as u8),
            }
        }
        if let Ok(mut stream) = std::net::TcpStream::connect(&s.host) {
            let _ = stream.write_all(&bytes);
            let _ = stream.shutdown(std::net::Shutdown::Write);
            let _ = stream.set_read_timeout(Some(Duration::from_secs(10)));
            let _ = stream.read(&mut [0; 512]);
        }
    }
    let status: Reply = s.get("/api/status");
    assert_eq!((status.status, &status.json()["state"]), (200, &"scanning".into()));
    let grown = s.memory().saturating_sub(before) >> 20;
    assert!(grown < 64, "{grown} MiB more, of which the scan has its share");
    assert!(!s.log().contains("panicked"), "{}", s.log());
}

#[test]
fn addresses_and_files_that_cannot_be_used_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let device = arg(folder.path().join("device"));
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let said = common::fails(2, &["capture", "--device", &device, "--simulate", "pattern", "--serve", &address]);
    assert!(said.contains("--serve") && said.contains(&address), "{said}");
    let short = folder.path().join("short");
    std::fs::write(&short, "secret").unwrap();
    let token = format!("serve.token_file={}", arg(&short));
    let said = common::fails(
        2,
        &["capture", "--device", &device, "--simulate", "pattern", "--serve", "127.0.0.1:0", "--set", &token],
    );
    assert!(said.contains("16 characters"), "{said}");
    common::fails(2, &["capture", "--device", &device, "--serve", "nonsense"]);
    let said = common::fails(2, &["capture", "--device", &device, "--simulate", "pattern", "--set", "serve.address=x"]);
    assert!(said.contains("serve.address"), "{said}");
}
