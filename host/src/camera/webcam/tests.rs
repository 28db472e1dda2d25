use super::frame::Layout;
use super::*;

const ORDERED: SystemTime = SystemTime::UNIX_EPOCH;

/// A frame with a noise of its own, taken so many milliseconds after the order.
fn frame(number: u8, after_ms: Option<i64>) -> Frame {
    let at = after_ms.map(|ms| match ms {
        0.. => ORDERED + Duration::from_millis(ms.unsigned_abs()),
        _ => ORDERED - Duration::from_millis(ms.unsigned_abs()),
    });
    Frame::new(Layout::Grey, 2, 1, &[number, 100], at).unwrap()
}

fn first_of(frames: Vec<Frame>, last: Option<&Frame>) -> std::result::Result<Frame, Stale> {
    let mut frames = frames.into_iter();
    fresh(ORDERED, last, || frames.next().ok_or_else(|| gone("a webcam", "ran out")))
}

#[test]
fn frames_from_before_the_order_are_thrown_away_by_number_and_by_time() {
    let silent = first_of((0..20).map(|i| frame(i, None)).collect(), None).ok().unwrap();
    assert_eq!(silent, frame(STALE_FRAMES as u8, None));
    // A queue that is longer than anybody thought.
    let timed = (0..40u8).map(|i| frame(i, Some(i64::from(i) * 30 - 500))).collect();
    assert_eq!(first_of(timed, None).ok().unwrap(), frame(17, Some(10)));
    let old = (0..MOST_FRAMES as u8 + 1).map(|i| frame(i, Some(-1))).collect();
    assert!(matches!(first_of(old, None), Err(Stale::Old)));
    assert!(matches!(first_of(vec![frame(0, None)], None), Err(Stale::Failed(_))));
}

#[test]
fn a_frame_that_comes_again_is_told() {
    let stuck = vec![frame(7, None); 20];
    assert!(matches!(first_of(stuck.clone(), None), Err(Stale::Repeated)));
    let again: Vec<Frame> = (0..20).map(|i| frame(i, None)).collect();
    assert!(matches!(first_of(again, Some(&frame(8, None))), Err(Stale::Repeated)));
    // All white twice is no wonder.
    let white = Frame::new(Layout::Grey, 2, 1, &[255, 255], None).unwrap();
    assert!(first_of(vec![white.clone(); 20], Some(&white)).is_ok());
}

#[test]
fn a_webcam_that_is_not_there_is_told_by_its_number() {
    let error = Webcam::open(63).err().unwrap().to_string();
    assert!(error.starts_with("webcam 63: "), "{error}");
}
