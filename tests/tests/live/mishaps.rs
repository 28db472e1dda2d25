//! What goes wrong with a table, a tracker or a lens while somebody turns costs no photograph that has its place.

use super::*;

fn small() -> Tour {
    Tour { photographs: 6, laps: 0.1, ..tour() }
}

fn open<'a>(folder: &Path, tour: &'a Tour) -> Live<'a> {
    Live::open(folder, &Tracking::default(), Wanted::default(), |_| Ok(options(tour))).unwrap()
}

/// A folder with the tour's photographs, but neither table nor tracker, and the tour itself.
fn photographs(tour: &Tour) -> (tempfile::TempDir, tempfile::TempDir) {
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    tour.write(all.path()).unwrap();
    (0..tour.photographs).for_each(|i| put(all.path(), folder.path(), i, tour));
    (all, folder)
}

fn why(arrivals: &[Arrival], name: &str) -> String {
    let arrival = arrivals.iter().find(|arrival| arrival.name == name && arrival.place.is_err());
    arrival.unwrap_or_else(|| panic!("{name}: {arrivals:?}")).place.clone().unwrap_err()
}

fn has_note(notes: &[String], name: &str, what: &str) -> bool {
    notes.iter().any(|note| note.contains(name) && note.contains(what))
}

#[test]
fn a_line_that_cannot_be_read_costs_no_other_its_place_nor_the_map() {
    let tour = small();
    let (_all, folder) = photographs(&tour);
    let to = folder.path();
    let turned = |i: usize| turned(&photograph(i), tour.truth()[i]);
    let short = turned(3).rsplit_once(',').unwrap().0.to_owned() + "\n";
    let lines = [
        turned(0),
        format!("{},0.9,oops,0,0\n", photograph(1)),
        turned(2),
        short,
        ",1,0,0,0\n".into(),
        turned(4),
    ];
    let mut table = format!("file,qw,qx,qy,qz\n{}", lines.concat()).into_bytes();
    table.extend([photograph(5).as_bytes(), b",\xff,0,0,0\n"].concat());
    fs::write(to.join("frames.csv"), &table).unwrap();
    let mut live = open(to, &tour);
    let arrivals = come(&mut live);
    assert_eq!(live.count(), 3, "{arrivals:?}");
    let faults = [(1, "qx = oops"), (3, "4 fields, of 5 columns"), (5, "UTF-8")];
    for (i, what) in faults {
        assert!(why(&arrivals, &photograph(i)).contains(what), "{arrivals:?}");
        assert!(why(&arrivals, &photograph(i)).contains(&format!("line {}", [0, 3, 0, 5, 0, 8][i])));
    }
    assert!(live.is_settled() && come(&mut live).is_empty());
    let (shots, notes) = live.finish().unwrap();
    assert_eq!((shots.shots.len(), notes.len()), (3, 4), "{notes:?}");
    assert!(faults.iter().all(|(i, what)| has_note(&notes, &photograph(*i), what)), "{notes:?}");
    assert!(has_note(&notes, "frames.csv", "no photograph in line 6"), "{notes:?}");
    // Whoever mends a line has its photograph at once.
    let mut live = open(to, &tour);
    come(&mut live);
    fs::write(to.join("frames.csv"), table_of(&tour, 6)).unwrap();
    assert_eq!(placed(&come(&mut live)).len(), 3);
    assert!(live.finish().unwrap().1.is_empty());
}

#[test]
fn a_last_line_that_ends_within_a_letter_waits_and_the_others_count() {
    let tour = small();
    let (_all, folder) = photographs(&tour);
    let to = folder.path();
    fs::rename(to.join(photograph(2)), to.join("übrig.png")).unwrap();
    let mut table = table_of(&tour, 2).into_bytes();
    table.push("ü".as_bytes()[0]);
    fs::write(to.join("frames.csv"), &table).unwrap();
    let mut live = open(to, &tour);
    assert_eq!(placed(&come(&mut live)).len(), 2);
    let (shots, notes) = live.finish().unwrap();
    assert!(shots.shots.len() == 2 && has_note(&notes, "frames.csv", "line break"), "{notes:?}");
}

#[test]
fn a_table_that_is_torn_emptied_or_gone_at_the_end_still_makes_the_map() {
    let tour = small();
    let (_all, folder) = photographs(&tour);
    let to = folder.path();
    let json: Vec<String> = (0..6)
        .map(|i| {
            format!(
                r#"{{"file": "{}", "yaw_deg": {}, "pitch_deg": 0, "roll_deg": 0}}"#,
                photograph(i),
                10 * i
            )
        })
        .collect();
    let json = format!(r#"{{"frames": [{}]}}"#, json.join(", "));
    for (name, whole, now) in [
        ("frames.json", json.as_str(), Some(&json[..json.len() / 2])),
        ("frames.json", &json, None),
        ("frames.csv", &table_of(&tour, 6), None),
        ("frames.csv", &table_of(&tour, 6), Some("")),
        ("frames.csv", &table_of(&tour, 6), Some("file,qw,qx,qy,qz\n")),
    ] {
        for is_seen in [false, true] {
            let table = to.join(name);
            fs::write(&table, whole).unwrap();
            let mut live = open(to, &tour);
            assert_eq!(placed(&come(&mut live)).len(), 6);
            match now {
                Some(now) => fs::write(&table, now).unwrap(),
                None => fs::remove_file(&table).unwrap(),
            }
            if is_seen {
                assert!(come(&mut live).is_empty() && !live.is_settled());
            }
            let (shots, notes) = live.finish().unwrap();
            assert!(shots.shots.len() == 6 && notes.len() == 1, "{name}: {notes:?}");
            assert!(has_note(&notes, name, "what it said before counts"), "{notes:?}");
            let _ = fs::remove_file(&table);
        }
    }
}

#[test]
fn a_first_line_without_a_usable_turn_does_not_make_a_table_one_of_times() {
    let tour = small();
    let (_all, folder) = photographs(&tour);
    let to = folder.path();
    let line = |i: usize| turned(&photograph(i), tour.truth()[i]).replacen(',', &format!(",{i}.5,"), 1);
    let mut text = format!("file,time_s,qw,qx,qy,qz\n{},0.5,0,0,0,0\n", photograph(0));
    fs::write(to.join("frames.csv"), &text).unwrap();
    let mut live = open(to, &tour);
    assert_eq!((come(&mut live).len(), live.count()), (1, 0));
    text += &(1..5).map(line).collect::<String>();
    text += &format!("{},,2,0,0,0\n", photograph(5));
    fs::write(to.join("frames.csv"), &text).unwrap();
    let arrivals = come(&mut live);
    assert_eq!(live.count(), 4, "{arrivals:?}");
    let (shots, notes) = live.finish().unwrap();
    assert_eq!((shots.shots.len(), notes.len()), (4, 2), "{notes:?}");
    for (i, what) in [(0, "quaternion of length 0.000"), (5, "quaternion of length 2.000")] {
        assert!(why(&arrivals, &photograph(i)).contains(what) && has_note(&notes, &photograph(i), what));
    }
}

#[test]
fn a_frames_json_that_gives_only_the_lens_gives_that_and_holds_nobody_up() {
    let tour = small();
    let (_all, folder) = photographs(&tour);
    let to = folder.path();
    let Lens { width, height, fx, cx, cy, .. } = tour.lens;
    let lens = format!(r#""intrinsics_{width}x{height}": {{"f": {fx}, "cx": {cx}, "cy": {cy}}}"#);
    fs::write(to.join("frames.json"), format!(r#"{{"frames": [], {lens}}}"#)).unwrap();
    assert_eq!(Live::lens_in(to), Some(tour.lens));
    let unknown = |_: &Path| Ok(Options { lens: None, ..options(&tour) });
    let session = || Live::open(to, &Tracking::default(), Wanted::default(), unknown).unwrap();
    // By their corners; then a table comes.
    let mut live = session();
    assert_eq!(placed(&come(&mut live)).len(), 6);
    fs::write(to.join("frames.csv"), table_of(&tour, 6)).unwrap();
    assert_eq!(come(&mut live).len(), 7);
    // And one that is there from the start.
    for mut live in [live, session()] {
        come(&mut live);
        let (shots, notes) = live.finish().unwrap();
        assert!(notes.is_empty() && shots.lens == Some(tour.lens), "{notes:?}");
        assert!(shots.shots[5].world_from_camera.angle_between(tour.truth()[5]) < 1e-6);
    }
}

#[test]
fn a_second_table_that_is_not_ones_own_is_never_written_over() {
    let tour = small();
    let (_all, folder) = photographs(&tour);
    let to = folder.path();
    let theirs = [("frames.csv", "file\n".to_owned()), ("frames-live.csv", table_of(&tour, 2))];
    for _ in 0..2 {
        let mut live = open(to, &tour);
        assert_eq!(placed(&come(&mut live)).len(), 6);
        theirs.iter().for_each(|(name, text)| fs::write(to.join(name), text).unwrap());
        let shots = live.finish().unwrap().0.shots;
        for (name, text) in &theirs {
            assert_eq!(&fs::read_to_string(to.join(name)).unwrap(), text, "{name}");
        }
        // One's own is replaced the next time.
        assert_eq!(Shots::read(&to.join("frames-live-2.csv")).unwrap().shots, shots);
        assert!(!to.join("frames-live-3.csv").exists());
        fs::remove_file(to.join("frames.csv")).unwrap();
    }
}

#[test]
fn a_tracker_that_comes_later_places_all_unless_photographs_have_their_places_already() {
    let tour = small();
    let (all, folder) = photographs(&tour);
    let to = folder.path();
    let records = to.join("tracker.jsonl");
    let times = head(all.path(), "frames.csv", |_, _| true);
    for table in [None, Some(times)] {
        for i in 0..6 {
            fs::remove_file(to.join(photograph(i))).unwrap();
        }
        if let Some(table) = &table {
            fs::write(to.join("frames.csv"), table).unwrap();
        }
        let mut live = open(to, &tour);
        come(&mut live);
        fs::write(&records, records_until(all.path(), 1e9)).unwrap();
        (0..6).for_each(|i| put(all.path(), to, i, &tour));
        let arrivals = come(&mut live);
        assert!(why(&arrivals, "tracker.jsonl").contains("has come"), "{arrivals:?}");
        assert!(live.count() == 6 && live.filter().is_some(), "{arrivals:?}");
        assert!(live.finish().unwrap().0.tracker.is_some());
        fs::remove_file(&records).unwrap();
        fs::remove_file(to.join("frames.csv")).unwrap();
    }
    // What can only be read as a whole is named, and so is what comes too late.
    fs::write(to.join("tracker.csv"), "time_s,qw,qx,qy,qz\n").unwrap();
    let mut live = open(to, &tour);
    let arrivals = come(&mut live);
    assert!(why(&arrivals, "tracker.csv").contains("tracker.jsonl") && live.count() == 6, "{arrivals:?}");
    fs::write(&records, records_until(all.path(), 1e9)).unwrap();
    assert!(why(&come(&mut live), "tracker.jsonl").contains("next --live"));
    assert!(come(&mut live).is_empty() && live.filter().is_none());
    assert!(has_note(&live.finish().unwrap().1, "tracker.jsonl", "next --live"));
}

#[test]
fn records_that_break_off_lose_nothing_of_what_has_its_place() {
    let tour = small();
    let (all, folder) = photographs(&tour);
    let to = folder.path();
    let records = records_until(all.path(), 1e9);
    fs::write(to.join("tracker.jsonl"), &records).unwrap();
    let mut live = Live::open(to, &tracking(&tour), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    let turns: Vec<DQuat> = placed(&come(&mut live)).iter().map(|place| place.turn).collect();
    fs::write(to.join("tracker.jsonl"), format!("{records}{{\n")).unwrap();
    let error = live.look().unwrap_err().to_string();
    assert!(error.contains("tracker.jsonl") && error.contains("line"), "{error}");
    let (shots, notes) = live.finish().unwrap();
    assert!(notes.is_empty() && Shots::read(to).unwrap().shots == shots.shots, "{notes:?}");
    let kept: Vec<DQuat> = shots.shots.iter().map(|shot| shot.world_from_camera).collect();
    assert!(turns.len() == 6 && rms_deg(&kept, &turns) < 1e-3, "{}", rms_deg(&kept, &turns));
}

#[test]
fn why_a_photograph_was_not_read_is_said_as_it_is() {
    let tour = small();
    let (all, folder) = photographs(&tour);
    let to = folder.path();
    let mut live = open(to, &tour);
    come(&mut live);
    for (name, look) in [("there.png", true), ("late.png", false)] {
        fs::copy(all.path().join(photograph(0)), to.join(name)).unwrap();
        if look {
            live.look().unwrap();
        }
    }
    let notes = live.finish().unwrap().1;
    assert!(has_note(&notes, "there.png", "had not been read by the end"), "{notes:?}");
    assert!(has_note(&notes, "late.png", "came too late"), "{notes:?}");
}

#[test]
fn photographs_that_go_on_coming_do_not_keep_the_turning_from_its_end() {
    let tour = small();
    let (all, folder) = photographs(&tour);
    let to = folder.path();
    (2..6).for_each(|i| fs::remove_file(to.join(photograph(i))).unwrap());
    fs::write(to.join("frames.csv"), table_of(&tour, 6)).unwrap();
    let mut live = open(to, &tour);
    assert_eq!(placed(&come(&mut live)).len(), 2);
    put(all.path(), to, 2, &tour);
    live.look().unwrap();
    live.close(true);
    let mut arrivals = vec![];
    for i in 3..6 {
        put(all.path(), to, i, &tour);
        arrivals.extend(live.look().unwrap());
        assert!(live.is_settled(), "{i}");
    }
    // One that was there before it was closed still counts.
    assert!(placed(&arrivals).len() == 1 && arrivals[0].name == photograph(2), "{arrivals:?}");
    live.close(false);
    assert_eq!(placed(&come(&mut live)).len(), 3);
}

#[test]
fn a_lens_that_shows_too_little_to_be_led_by_is_refused() {
    let lens = |across_deg: f64| Lens::pinhole(240, 180, 120.0 / (across_deg / 2.0).to_radians().tan());
    assert!(Live::require(&lens(3.0)).is_ok());
    let tour = Tour { lens: lens(2.5), ..small() };
    let refused = Live::require(&tour.lens).unwrap_err().to_string();
    assert!(refused.contains("2.50 by 1.88 degrees") && refused.contains("--live"), "{refused}");
    let (_all, folder) = photographs(&small());
    let mut live = open(folder.path(), &tour);
    assert_eq!((0..2).find_map(|_| live.look().err()).unwrap().to_string(), refused);
}
