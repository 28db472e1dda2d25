use std::time::{SystemTime, UNIX_EPOCH};

use super::*;
use crate::camera::exif;
use crate::capture::{add_views, capture, plan};
use crate::progress::Silent;
use crate::rig::{Reached, Rig, RigLimits};
use crate::sampling::Stop;
use crate::session::{Manifest, Session, View};

const WAIT: Duration = Duration::from_millis(350);

/// A little photograph that says when and for how long it was exposed; `level` makes its content.
pub(in crate::camera) fn photograph(exposure_s: f64, at: SystemTime, level: u8) -> Vec<u8> {
    use image::ImageEncoder;
    let mut bytes = vec![];
    let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut bytes);
    encoder.set_exif_metadata(exif::block(exposure_s, Some(at))).unwrap();
    encoder.write_image(&[level; 48], 4, 4, image::ExtendedColorType::Rgb8).unwrap();
    bytes
}

fn second(number: u64) -> SystemTime {
    UNIX_EPOCH + Duration::from_secs(1_790_000_000 + number)
}

struct Bench {
    folder: tempfile::TempDir,
    session: tempfile::TempDir,
    camera: FolderCamera,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let session = tempfile::tempdir().unwrap();
        let camera = FolderCamera::open(folder.path(), HashMap::new(), WAIT).unwrap();
        Self { folder, session, camera }
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.folder.path().join(name), bytes).unwrap();
    }

    fn take(&mut self, exposure_s: f64, name: &str) -> Result<Taken> {
        self.camera.photograph(exposure_s, &self.session.path().join(name)).and_then(Shot::taken)
    }
}

#[test]
fn photographs_are_taken_in_the_order_of_their_names_with_their_own_times() {
    let mut bench = Bench::new();
    bench.put("b.jpg", &photograph(0.26, second(2), 2));
    bench.put("a.JPG", &photograph(0.5, second(1), 1));
    bench.put("a.txt", b"not a photograph");
    let first = bench.take(0.5, "view.0").unwrap();
    assert_eq!(first, Taken { file: bench.session.path().join("view.0.JPG"), exposure_s: 0.5 });
    let copy = std::fs::read(&first.file).unwrap();
    assert_eq!(copy, std::fs::read(bench.folder.path().join("a.JPG")).unwrap());
    assert_eq!(bench.take(0.25, "view.1").unwrap().exposure_s, 0.26);
    let error = bench.take(0.125, "view.2").unwrap_err().to_string();
    assert!(error.contains("no photograph came"), "{error}");
}

#[test]
fn a_photograph_that_is_still_being_written_is_waited_for() {
    let mut bench = Bench::new();
    bench.camera.wait = Duration::from_secs(20);
    let bytes = photograph(0.5, second(1), 1);
    let path = bench.folder.path().join("slow.jpg");
    let whole = bytes.clone();
    let writer = std::thread::spawn(move || {
        for end in [0, 1, 300, whole.len() - 1, whole.len()] {
            std::fs::write(&path, &whole[..end]).unwrap();
            // Longer than two looks: its size alone does not tell that it is not whole.
            std::thread::sleep(Duration::from_millis(250));
        }
    });
    let taken = bench.take(0.5, "a").unwrap();
    assert_eq!(std::fs::read(taken.file).unwrap(), bytes);
    writer.join().unwrap();
}

#[test]
fn a_file_that_does_not_fit_is_refused_by_name() {
    let refused = |bytes: &[u8], what: &str| {
        let mut bench = Bench::new();
        bench.put("a.jpg", &photograph(0.5, second(5), 1));
        bench.take(0.5, "first").unwrap();
        bench.put("wrong.jpg", bytes);
        let error = bench.take(0.25, "second").unwrap_err().to_string();
        assert!(error.contains("wrong.jpg") && error.contains(what), "{error}");
        assert!(!bench.session.path().join("second.jpg").exists());
    };
    let good = photograph(0.25, second(6), 2);
    refused(&photograph(0.125, second(6), 2), "0.125 s where 0.25 s");
    refused(&photograph(0.25, second(4), 2), "was taken 1.0 s before");
    refused(&photograph(0.5, second(5), 1), "the same photograph as");
    refused(&good[..good.len() / 2], "cut short");
    refused(b"words", "decoded");
}

#[test]
fn what_comes_after_the_start_and_is_older_than_its_view_is_refused_by_name() {
    let write = |bench: &Bench, name: &str, age_s: u64| {
        let path = bench.folder.path().join(name);
        std::fs::write(&path, photograph(0.5, second(1), 1)).unwrap();
        let file = std::fs::File::options().write(true).open(path).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(age_s)).unwrap();
    };
    for (age_s, fits) in [(0, true), (1, true), (4, false), (100_000, false)] {
        let mut bench = Bench::new();
        write(&bench, "late.jpg", age_s);
        match bench.take(0.5, "view0") {
            Ok(_) => assert!(fits, "{age_s} s"),
            Err(error) => {
                let error = error.to_string();
                assert!(!fits && error.contains("late.jpg") && error.contains("asked for"), "{error}");
            }
        }
    }
    // What is there at the start may be as old as it likes.
    let mut bench = Bench::new();
    write(&bench, "old.jpg", 100_000);
    bench.camera = FolderCamera::open(bench.folder.path(), HashMap::new(), WAIT).unwrap();
    bench.take(0.5, "view0").unwrap();
}

#[test]
fn after_an_interruption_what_was_taken_is_not_taken_again() {
    let mut bench = Bench::new();
    bench.put("a.jpg", &photograph(0.5, second(1), 1));
    bench.put("b.jpg", &photograph(0.5, second(2), 2));
    let first = bench.take(0.5, "view0").unwrap().file;
    let taken = HashMap::from([(file::sha256(&first).unwrap().1, first)]);
    bench.camera = FolderCamera::open(bench.folder.path(), taken, WAIT).unwrap();
    let taken = bench.take(0.5, "view1").unwrap();
    assert_eq!(std::fs::read(taken.file).unwrap(), std::fs::read(bench.folder.path().join("b.jpg")).unwrap());
}

#[test]
fn a_folder_that_is_not_there_is_refused_at_once() {
    let error = FolderCamera::open(Path::new("/nonexistent"), HashMap::new(), WAIT).err().unwrap();
    assert!(error.to_string().contains("/nonexistent"), "{error}");
}

/// A rig that is where it is sent.
struct Still;

impl Rig for Still {
    fn limits(&self) -> RigLimits {
        RigLimits {
            pan_rad: [-1.0, 1.0],
            tilt_rad: [-1.0, 1.0],
            speed_rad_s: 1.0,
            acceleration_rad_s2: 1.0,
            settle_s: 0.0,
        }
    }

    fn move_to(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<Reached> {
        Ok(Reached { pan_rad, tilt_rad, settle_s: 0.0 })
    }

    fn is_there(&mut self, _pan_rad: f64, _tilt_rad: f64) -> Result<bool> {
        Ok(true)
    }

    fn describe(&self) -> String {
        "still".into()
    }

    fn take_notices(&mut self) -> Vec<String> {
        vec![]
    }
}

#[test]
fn a_plan_counts_the_time_that_a_photograph_may_take_to_come() {
    let mut manifest = Manifest { longest_exposure_s: Some(0.5), ..Manifest::new("test") };
    add_views(&mut manifest, &[Stop { view: 0, pan_rad: 0.0, tilt_rad: 0.0 }; 3]);
    let folder = tempfile::tempdir().unwrap();
    let most = |wait_s: u64| {
        let wait = Duration::from_secs(wait_s);
        let camera = FolderCamera::open(folder.path(), HashMap::new(), wait).unwrap();
        plan(&manifest, &[], &Still, &camera).unwrap()
    };
    let (quick, slow) = (most(0), most(120));
    let more_s = slow.most_seconds - quick.most_seconds;
    assert!((more_s - 120.0 * slow.most_photographs as f64).abs() < 1e-6, "{more_s} s");
}

/// What each view of a session got, in order.
fn contents(session: &Session) -> Vec<String> {
    let photographs = (0..3).flat_map(|view| session.photographs(view));
    photographs.map(|photograph| file::sha256(&session.photograph_path(photograph)).unwrap().1).collect()
}

#[test]
fn a_photograph_that_was_moved_and_not_journaled_is_taken_again_and_no_other_instead() {
    let folder = tempfile::tempdir().unwrap();
    let (path, inbox) = (folder.path().join("session"), folder.path().join("inbox"));
    std::fs::create_dir(&inbox).unwrap();
    // Two of each view: the first has saturated pixels.
    for index in 0..6u8 {
        let level = if index % 2 == 0 { 255 } else { 100 + index };
        let bytes = photograph(0.5 / f64::from(1 + index % 2), second(index.into()), level);
        std::fs::write(inbox.join(format!("{index}.jpg")), bytes).unwrap();
    }
    let view = |index: usize| View {
        name: format!("view{index}"),
        pan_deg: Some(0.0),
        tilt_deg: Some(0.0),
        lens: 0,
        pose: None,
    };
    let manifest = Manifest {
        views: (0..3).map(view).collect(),
        longest_exposure_s: Some(0.5),
        ..Manifest::new("test")
    };
    let complete = |session: &mut Session| {
        session.verify(false, &Silent).unwrap();
        let mut camera = FolderCamera::open(&inbox, session.taken().unwrap(), WAIT).unwrap();
        capture(session, &mut Still, &mut camera, &Silent).unwrap();
        contents(session)
    };
    let whole = complete(&mut Session::create(&path, manifest).unwrap());
    let originals: Vec<String> =
        list(&inbox).unwrap().0.iter().map(|path| file::sha256(path).unwrap().1).collect();
    assert_eq!(whole, originals);
    let journal = path.join("journal.jsonl");
    let lines = std::fs::read_to_string(&journal).unwrap();
    let lines: Vec<&str> = lines.split_inclusive('\n').collect();
    for cut in 0..lines.len() {
        std::fs::write(&journal, lines[..cut].concat()).unwrap();
        assert_eq!(complete(&mut Session::open(&path).unwrap()), whole, "cut after line {cut}");
    }
    // So is one that the journal has and that is damaged.
    std::fs::write(path.join("photographs/view1_0.jpg"), "damage").unwrap();
    assert_eq!(complete(&mut Session::open(&path).unwrap()), whole);
}
