//! Chessboards to lenses: real ones against what OpenCV finds, simulated ones against the truth.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::path::{Path, PathBuf};

use glam::DVec2;
use rand::rngs::StdRng;
use rigel::calibration::{
    BoardCorner, BoardSize, BoardView, LensModel, Sighting, calibrate_lens, calibrate_photographs, find_board,
};
use rigel::geometry::Lens;
use rigel::picture::Picture;
use rigel::progress::Silent;
use rigel_simulated::board::{Board, Look, normal, strew};
use rigel_tests::data;

const NINE_BY_SIX: BoardSize = BoardSize { columns: 9, rows: 6 };

/// The lens of `peers/d_calib.py`.
fn lens() -> Lens {
    Lens {
        fx: 540.0,
        fy: 538.0,
        cx: 330.0,
        cy: 236.0,
        k1: -0.28,
        k2: 0.09,
        p1: 0.001,
        p2: -0.0005,
        ..Lens::pinhole(640, 480, 540.0)
    }
}

fn photographs(folder: &Path, start: &str) -> Vec<PathBuf> {
    let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut paths: Vec<PathBuf> = names
        .filter(|path| {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            name.starts_with(start) && name.ends_with(".jpg")
        })
        .collect();
    paths.sort();
    paths
}

/// How far corners are from the truth, whichever way round the board was taken to be.
fn error_px(corners: &[BoardCorner], truth: &[DVec2], size: BoardSize) -> f64 {
    let last = truth.len() - 1;
    let square = |flip: bool| -> f64 {
        let of = |corner: &BoardCorner| {
            let i = (corner.row * size.columns + corner.column) as usize;
            corner.pixel.distance_squared(truth[if flip { last - i } else { i }])
        };
        corners.iter().map(of).sum()
    };
    (square(false).min(square(true)) / corners.len() as f64).sqrt()
}

/// The corners of a board as noise would show them.
fn noisy(board: &Board, lens: &Lens, sigma_px: f64, random: &mut StdRng) -> BoardView {
    let corners = board.corners(lens).unwrap().into_iter().enumerate().map(|(i, pixel)| BoardCorner {
        column: i as u32 % board.columns,
        row: i as u32 / board.columns,
        pixel: pixel + sigma_px * DVec2::new(normal(random), normal(random)),
        sigma_px,
        blur_px: 0.6,
    });
    BoardView { path: "board.png".into(), corners: corners.collect() }
}

#[test]
fn every_board_of_opencv_s_sample_gives_opencv_s_lens() {
    let Some(folder) = data("calibration/opencv_left") else { return };
    let paths = photographs(&folder, "left");
    assert_eq!(paths.len(), 13);
    let found = calibrate_photographs(&paths, NINE_BY_SIX, 0.025, Some(LensModel::All), &Silent).unwrap();
    println!("{:#?} {:?} RMS {}", found.lens, found.sigmas(), found.rms_px);
    assert_eq!((found.boards.len(), &found.dropped[..]), (13, &[][..]));
    assert!(found.boards.iter().all(|board| board.corners.len() == 54));
    assert!(found.rms_px <= 0.41, "{}", found.rms_px);
    assert!((found.lens.fx - 536.07).abs() < 1.0, "{}", found.lens.fx);
}

#[test]
fn every_wide_angle_board_that_opencv_finds_is_found() {
    let Some(folder) = data("calibration/gopro_wide") else { return };
    // OpenCV 5's findChessboardCorners and findChessboardCornersSB both find exactly these.
    let names = [32, 34, 36, 38, 41, 43, 45, 47, 49, 51, 53, 57, 59, 61, 63, 66, 68, 69, 70];
    let paths: Vec<PathBuf> = names.iter().map(|n| folder.join(format!("GOPR00{n}.jpg"))).collect();
    let board = BoardSize { columns: 8, rows: 6 };
    let found = calibrate_photographs(&paths, board, 0.1, None, &Silent).unwrap();
    println!("{:#?} {:?} RMS {} {}", found.lens, found.model, found.rms_px, found.verdict);
    assert_eq!((found.boards.len(), &found.dropped[..]), (names.len(), &[][..]));
    assert!(found.boards.iter().all(|board| board.corners.len() == 48));
    assert!(found.rms_px <= 0.55, "{}", found.rms_px);
}

#[test]
fn simulated_boards_are_found_to_a_few_hundredths_of_a_pixel() {
    let lens = lens();
    let (mut square, mut count) = (0.0, 0.0);
    for (i, board) in strew(&lens, 9, 6, 14, 1).iter().enumerate() {
        let picture = board.photograph(&lens, &Look { seed: i as u64, ..Look::default() });
        let Sighting::Whole(corners) = find_board(&picture, NINE_BY_SIX) else { panic!("board {i}") };
        let error = error_px(&corners, &board.corners(&lens).unwrap(), NINE_BY_SIX);
        square += error * error;
        count += 1.0;
    }
    let rms = f64::sqrt(square / count);
    println!("RMS {rms:.4} px");
    assert!(rms < 0.06, "{rms}");
}
