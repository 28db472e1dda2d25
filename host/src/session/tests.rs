use super::*;

fn manifest() -> Manifest {
    let view = |name: &str| View {
        name: name.into(),
        pan_deg: Some(10.0),
        tilt_deg: Some(20.0),
        lens: 0,
        pose: None,
    };
    Manifest { views: vec![view("view000"), view("view001")], ..Manifest::new("test") }
}

fn photograph(view: usize, file: &str) -> Event {
    Event::Photograph(Photograph { view, file: file.into(), exposure_s: Some(0.5), ..Photograph::default() })
}

#[test]
fn what_was_recorded_is_there_after_reopening() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::create(folder.path(), manifest()).unwrap();
    session.record(photograph(0, "photographs/a.jpg")).unwrap();
    session.record(Event::ViewDone { view: 0 }).unwrap();
    session.record(photograph(1, "photographs/b.jpg")).unwrap();
    drop(session);
    let session = Session::open(folder.path()).unwrap();
    assert_eq!(session.manifest, manifest());
    assert_eq!(session.done_views(), [0]);
    assert_eq!(session.photographs(1).len(), 1);
}

#[test]
fn a_torn_last_line_is_forgotten_and_the_journal_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::create(folder.path(), manifest()).unwrap();
    session.record(photograph(0, "photographs/a.jpg")).unwrap();
    drop(session);
    let path = folder.path().join("journal.jsonl");
    let mut text = fs::read_to_string(&path).unwrap();
    text.push_str("{\"photograph\":{\"view\":0,\"fi");
    fs::write(&path, text).unwrap();
    let mut session = Session::open(folder.path()).unwrap();
    assert_eq!(session.photographs(0).len(), 1);
    session.record(photograph(0, "photographs/c.jpg")).unwrap();
    drop(session);
    assert_eq!(Session::open(folder.path()).unwrap().photographs(0).len(), 2);
}

#[test]
fn damage_inside_the_journal_is_an_error_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::create(folder.path(), manifest()).unwrap();
    session.record(photograph(0, "photographs/a.jpg")).unwrap();
    session.record(photograph(0, "photographs/b.jpg")).unwrap();
    drop(session);
    let path = folder.path().join("journal.jsonl");
    let text = fs::read_to_string(&path).unwrap().replacen("photograph", "phot\u{0}graph", 1);
    fs::write(&path, text).unwrap();
    let message = Session::open(folder.path()).unwrap_err().to_string();
    assert!(message.contains("line 1"), "{message}");
}

#[test]
fn views_whose_files_would_meet_or_lie_elsewhere_are_refused() {
    for name in ["view000", "", "../view001", "a\\b"] {
        let folder = tempfile::tempdir().unwrap();
        let mut twice = manifest();
        twice.views[1].name = name.into();
        Session::create(folder.path(), twice).unwrap();
        let message = Session::open(folder.path()).unwrap_err().to_string();
        assert!(message.contains("session.toml") && message.contains(name), "{message}");
    }
}

#[test]
fn an_occupied_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("precious.txt"), "x").unwrap();
    assert!(Session::create(folder.path(), manifest()).is_err());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}
