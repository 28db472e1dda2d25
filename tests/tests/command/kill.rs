//! `kill -9` at random moments of a capture: at most one photograph is lost, and what is resumed is what it would have been.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[allow(dead_code, reason = "each test uses a part of it")]
mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use rigel::progress::Silent;
use rigel::session::{Event, Photograph, Session};

use common::{assert_refused, rigel, snapshot, succeed};

/// Divided among the workers.
const KILLS: usize = 200;
const WORKERS: usize = 2;
const CAPTURE: [&str; 8] =
    ["capture", "session", "--sampling", "spiral", "--views", "3", "--longest-exposure-time", "0.02"];
const RESUME: [&str; 3] = ["capture", "session", "--resume"];

/// Everything in a session but when and with which port it was made.
#[derive(PartialEq)]
struct Content {
    files: BTreeMap<PathBuf, Option<Vec<u8>>>,
    manifest: String,
    photographs: Vec<Photograph>,
}

fn content(folder: &Path) -> Content {
    let session = Session::open(folder).unwrap();
    assert_eq!(session.done_views().len(), session.manifest.views.len());
    let mut files: BTreeMap<_, _> = snapshot(folder)
        .into_iter()
        .map(|(path, bytes)| (path.strip_prefix(folder).unwrap().to_path_buf(), bytes))
        .collect();
    files.remove(Path::new("journal.jsonl"));
    files.remove(Path::new("session.toml"));
    let mut manifest = session.manifest.clone();
    manifest.source.clear();
    let photographs = (0..manifest.views.len()).flat_map(|view| session.photographs(view));
    let photographs = photographs.map(|p| Photograph { at: None, ..p.clone() }).collect();
    Content { files, manifest: format!("{manifest:?}"), photographs }
}

/// How many photographs the journal was told of, those that were taken again counted again.
fn told(session: &Session) -> usize {
    session.events().iter().filter(|event| matches!(event, Event::Photograph(_))).count()
}

/// What must be true of a session at any moment at which its capture may have died. Returns how many photographs were lost:
/// those that are there, in whatever state, and not in the journal. One that was in its place and untold at one kill, and
/// half taken again at the next, is one photograph in two files.
fn lost(folder: &Path) -> usize {
    if !folder.join("session.toml").exists() {
        return 0;
    }
    let mut session = Session::open(folder).unwrap();
    assert_eq!(session.verify(true, &Silent).unwrap(), Vec::<String>::new(), "the journal tells the truth");
    let known: BTreeSet<PathBuf> = (0..session.manifest.views.len())
        .flat_map(|view| session.photographs(view))
        .map(|photograph| session.photograph_path(photograph))
        .collect();
    let pictures = snapshot(folder).into_keys().filter(|path| {
        let inside = path.strip_prefix(folder).unwrap();
        path.is_file() && (inside.starts_with("photographs") || inside.parent() == Some(Path::new("taking")))
    });
    let stem =
        |path: PathBuf| path.file_name().unwrap().to_str().unwrap().split('.').next().unwrap().to_owned();
    pictures.filter(|path| !known.contains(path)).map(stem).collect::<BTreeSet<_>>().len()
}

/// Starts captures and kills them, each after a random part of `whole`; checks whatever comes to its end.
fn kill_again_and_again(worker: u64, whole: Duration, expected: &Content) -> (usize, usize) {
    let mut folder = tempfile::tempdir().unwrap();
    let (mut kills, mut all_lost, mut sessions) = (0, 0, 0);
    let mut random = worker;
    while kills < KILLS / WORKERS {
        let session = folder.path().join("session");
        let arguments = if session.join("session.toml").exists() { &RESUME[..] } else { &CAPTURE[..] };
        let mut command = rigel(folder.path(), arguments);
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        std::thread::sleep(whole.mul_f64((random >> 11) as f64 / (1_u64 << 53) as f64));
        child.kill().unwrap();
        let output = child.wait_with_output().unwrap();
        if output.status.code().is_none() {
            kills += 1;
            let lost = lost(&session);
            assert!(lost <= 1, "kill {kills} has lost {lost} photographs");
            all_lost += lost;
        } else {
            // It was faster.
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
        let complete = Session::open(&session).is_ok_and(|s| s.done_views().len() == s.manifest.views.len());
        if complete || kills == KILLS / WORKERS {
            let arguments = if session.join("session.toml").exists() { &RESUME[..] } else { &CAPTURE[..] };
            succeed(folder.path(), arguments);
            assert!(content(&session) == *expected, "session {sessions} of worker {worker} is another");
            let session = Session::open(&session).unwrap();
            assert_eq!(told(&session), expected.photographs.len(), "nothing that was told is taken again");
            sessions += 1;
            folder = tempfile::tempdir().unwrap();
        }
    }
    (sessions, all_lost)
}

#[test]
fn killed_at_random_moments_a_capture_loses_one_photograph_at_most() {
    let folder = tempfile::tempdir().unwrap();
    let start = Instant::now();
    succeed(folder.path(), &CAPTURE);
    let whole = start.elapsed();
    let expected = content(&folder.path().join("session"));
    assert!(expected.photographs.len() > 4);
    let outcomes: Vec<(usize, usize)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (1..=WORKERS as u64)
            .map(|worker| {
                scope.spawn({
                    let expected = &expected;
                    move || kill_again_and_again(worker, whole, expected)
                })
            })
            .collect();
        workers.into_iter().map(|worker| worker.join().unwrap()).collect()
    });
    let sessions: usize = outcomes.iter().map(|outcome| outcome.0).sum();
    let lost: usize = outcomes.iter().map(|outcome| outcome.1).sum();
    println!(
        "{KILLS} kills of captures of {} photographs that take {:.2} s: {sessions} sessions, all as undisturbed; \
         {lost} photographs were lost and taken again, never two at once; {:.0} s",
        expected.photographs.len(),
        whole.as_secs_f64(),
        start.elapsed().as_secs_f64()
    );
}

#[test]
fn the_second_of_two_captures_is_refused_and_a_dead_one_is_not_in_the_way() {
    let folder = tempfile::tempdir().unwrap();
    let capture = ["capture", "session", "--views", "17", "--longest-exposure-time", "0.02"];
    let mut first = rigel(folder.path(), &capture).stdout(Stdio::null()).spawn().unwrap();
    let journal = folder.path().join("session/journal.jsonl");
    while !fs::read_to_string(&journal).is_ok_and(|text| text.contains("view_done")) {
        assert!(first.try_wait().unwrap().is_none(), "the first capture ended too early");
        std::thread::sleep(Duration::from_millis(2));
    }
    let second = rigel(folder.path(), &RESUME).output().unwrap();
    first.kill().unwrap();
    first.wait().unwrap();
    assert_refused("the second capture", &second, &["session", "another rigel"]);
    let done = Session::open(&folder.path().join("session")).unwrap().done_views().len();
    assert!((1..17).contains(&done), "{done}");
    succeed(folder.path(), &RESUME);
}
