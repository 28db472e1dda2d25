use std::sync::{Arc, Mutex};

use super::*;
use crate::camera::folder::tests::photograph;

/// What the camera on the line does when it is released for the `n`th time, into its folder.
type Behaviour = Box<dyn FnMut(usize, f64, SystemTime, &Path) + Send>;

struct Bench {
    folder: tempfile::TempDir,
    session: tempfile::TempDir,
    camera: TriggerCamera,
    /// The host's clock, as far as the camera can tell.
    now: Arc<Mutex<SystemTime>>,
}

impl Bench {
    fn new(mut behaviour: Behaviour) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("old.jpg"), photograph(1.0, SystemTime::UNIX_EPOCH, 0)).unwrap();
        let now = Arc::new(Mutex::new(SystemTime::UNIX_EPOCH + Duration::from_secs(1_790_000_000)));
        let (clock, path, mut count) = (now.clone(), folder.path().to_path_buf(), 0);
        let shutter: Shutter = Box::new(move |exposure_s| {
            let at = *clock.lock().unwrap();
            behaviour(count, exposure_s, at, &path);
            count += 1;
            Ok(at)
        });
        let camera = TriggerCamera::new(shutter, Some(folder.path()), Duration::from_millis(350)).unwrap();
        Self { folder, session: tempfile::tempdir().unwrap(), camera, now }
    }

    fn take(&mut self, exposure_s: f64, name: &str) -> Result<Taken> {
        *self.now.lock().unwrap() += Duration::from_secs(5);
        self.camera.photograph(exposure_s, &self.session.path().join(name)).and_then(Shot::taken)
    }
}

/// Writes one photograph by a clock that is two hours and a bit behind.
fn good(count: usize, exposure_s: f64, at: SystemTime, folder: &Path) {
    let at = at - Duration::from_millis(7_212_345);
    let name = format!("dsc{count}.jpg");
    std::fs::write(folder.join(name), photograph(exposure_s, at, count as u8)).unwrap();
}

#[test]
fn each_exposure_gets_its_photograph_untouched() {
    let mut bench = Bench::new(Box::new(good));
    for (index, exposure_s) in [0.5, 0.25, 0.125, 0.0625].into_iter().enumerate() {
        let taken = bench.take(exposure_s, &format!("view{index}")).unwrap();
        assert_eq!(taken.exposure_s, exposure_s);
        let original = bench.folder.path().join(format!("dsc{index}.jpg"));
        assert_eq!(std::fs::read(taken.file).unwrap(), std::fs::read(original).unwrap());
    }
}

#[test]
fn without_a_folder_the_photograph_comes_later() {
    let at = SystemTime::UNIX_EPOCH + Duration::from_secs(7);
    let mut camera = TriggerCamera::new(Box::new(move |_| Ok(at)), None, Duration::ZERO).unwrap();
    let shot = camera.photograph(0.5, Path::new("nowhere")).unwrap();
    assert_eq!(shot, Shot::Later { exposure_s: 0.5, at });
    assert!(shot.taken().is_err());
}

/// The second photograph goes wrong.
fn refused(wrong: impl Fn(f64, SystemTime, &Path) + Send + 'static, file: &str, what: &str) {
    let mut bench = Bench::new(Box::new(move |count, exposure_s, at, folder| match count {
        1 => wrong(exposure_s, at, folder),
        _ => good(count, exposure_s, at, folder),
    }));
    bench.take(0.5, "first").unwrap();
    let error = bench.take(0.25, "second").unwrap_err().to_string();
    assert!(error.contains(file) && error.contains(what), "{error}");
    assert!(!bench.session.path().join("second.jpg").exists());
}

#[test]
fn what_the_camera_does_wrong_is_told_by_the_name_of_the_file() {
    refused(|_, _, _| {}, "", "no photograph came");
    refused(
        |exposure_s, at, folder| (1..3).for_each(|count| good(count, exposure_s, at, folder)),
        "dsc2.jpg",
        "came together with",
    );
    refused(|_, at, folder| good(1, 0.5, at, folder), "dsc1.jpg", "0.5 s where 0.25 s");
    refused(
        |exposure_s, at, folder| good(1, exposure_s, at - Duration::from_secs(3), folder),
        "dsc1.jpg",
        "3.0 s earlier",
    );
    refused(
        |exposure_s, at, folder| good(1, exposure_s, at + Duration::from_secs(3600), folder),
        "dsc1.jpg",
        "3600.0 s later",
    );
    refused(
        |_, _, folder| std::fs::copy(folder.join("dsc0.jpg"), folder.join("again.jpg")).map(|_| ()).unwrap(),
        "again.jpg",
        "the same photograph as",
    );
    refused(
        |_, _, folder| {
            std::fs::write(folder.join("torn.jpg"), &photograph(0.25, SystemTime::UNIX_EPOCH, 1)[..200])
                .unwrap()
        },
        "torn.jpg",
        "cut short",
    );
}

#[test]
fn a_photograph_that_comes_too_late_is_not_taken_for_the_next() {
    let mut bench = Bench::new(Box::new(|count, exposure_s, at, folder| {
        if count != 1 {
            good(count, exposure_s, at, folder);
        }
    }));
    bench.take(0.5, "first").unwrap();
    bench.take(0.25, "second").unwrap_err();
    good(1, 0.25, *bench.now.lock().unwrap(), bench.folder.path());
    let error = bench.take(0.25, "third").unwrap_err().to_string();
    assert!(error.contains("dsc1.jpg") && error.contains("without an exposure"), "{error}");
}

#[test]
fn an_impossible_time_does_not_release_the_camera() {
    let mut bench = Bench::new(Box::new(|_, _, _, _| panic!("released")));
    for exposure_s in [0.0, -1.0, 1e-3, 1e4, f64::NAN] {
        let error = bench.take(exposure_s, "a").unwrap_err();
        assert!(error.to_string().contains("choose a time"), "{error}");
    }
}

#[test]
fn an_error_of_the_shutter_is_passed_on() {
    let shutter: Shutter = Box::new(|_| Err(Error::request("the rig is gone", "plug it in")));
    let mut camera = TriggerCamera::new(shutter, None, Duration::ZERO).unwrap();
    assert!(camera.photograph(0.5, Path::new("a")).unwrap_err().to_string().contains("gone"));
}
