//! What can be typed to see a map, and to give it to others.

use std::path::PathBuf;

use clap::{ArgGroup, Args};
use rigel::geometry::Texels;
#[cfg(feature = "viewer")]
use rigel::units::parse_texel;
use rigel::units::{parse_degrees, parse_length_m, parse_pixels};

/// Where the camera is.
#[derive(Args)]
pub struct Camera {
    /// Camera from a TOML or JSON file: fx fy cx cy width height, centre (mm), forward, up
    #[arg(long, conflicts_with_all = ["pan", "tilt"])]
    pub camera: Option<PathBuf>,
    /// Where the camera file has the centre of the first pixel: 0 as OpenCV, or 0.5
    #[arg(long, default_value_t = 0.0)]
    pub pixel_centre: f64,
    /// Pan of the rig, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true, value_parser = parse_degrees)]
    pub pan: f64,
    /// Tilt of the rig, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true, value_parser = parse_degrees)]
    pub tilt: f64,
    /// Distance from the rig's centre to the camera [default: four times the surface's longer side]
    #[arg(long, value_parser = parse_length_m)]
    pub distance: Option<f64>,
    /// Columns and rows of pixels; not with --camera, which has its own
    #[arg(long, default_value = "800x600", value_parser = parse_pixels, conflicts_with = "camera")]
    pub size: Texels,
    /// Gamma of the exposure function y = 1 - exp(-gamma x) [default: half grey for the median]
    #[arg(long, value_parser = super::parse_gamma)]
    pub gamma: Option<f32>,
}

#[cfg(feature = "viewer")]
#[derive(Args)]
pub struct View {
    /// Parameter maps; `m` goes from one to the next
    #[arg(required = true)]
    pub maps: Vec<PathBuf>,
    /// The session whose photographs are compared with the map, and whose observations a texel's radiance is drawn with
    #[arg(long)]
    pub session: Option<PathBuf>,
    /// Write ten views of the session to a PNG and open no window: photograph, reconstruction and difference, each on the surface's rectangle
    #[arg(long, value_name = "FILE", requires = "session", conflicts_with_all = ["headless", "screenshot", "texel", "false_colour"])]
    pub contact_sheet: Option<PathBuf>,
    /// Draw this texel's radiance against direction beside the picture
    #[arg(long, value_name = "COLUMN,ROW", value_parser = parse_texel)]
    pub texel: Option<(u32, u32)>,
    /// Open no window
    #[arg(long, requires = "screenshot")]
    pub headless: bool,
    /// Write what is seen first to a PNG
    #[arg(long, value_name = "FILE")]
    pub screenshot: Option<PathBuf>,
    /// Where models are evaluated: by-pixel (exact), by-texel (fast), or automatic: by texel where that looks the same
    #[arg(long, value_enum, default_value = "automatic")]
    pub shading: ShadingChoice,
    /// Show luminance as colours
    #[arg(long)]
    pub false_colour: bool,
    #[command(flatten)]
    pub camera: Camera,
    /// Replace the picture that is there
    #[arg(long)]
    pub force: bool,
}

#[cfg(feature = "viewer")]
#[derive(Clone, Copy, clap::ValueEnum)]
pub enum ShadingChoice {
    Automatic,
    ByPixel,
    ByTexel,
}

#[derive(Args)]
#[command(group = ArgGroup::new("what").required(true).args(["web", "splats", "exr", "zarr"]))]
pub struct Export {
    /// Parameter maps: a page holds several, splats one. For --exr and --zarr observations (observations.rigel, or a session)
    #[arg(required = true, value_name = "FILE")]
    pub maps: Vec<PathBuf>,
    /// One page that needs no network
    #[arg(long, value_name = "FILE")]
    pub web: Option<PathBuf>,
    /// Gaussian splats for the viewers of that format, with harmonics up to degree 3
    #[arg(long, value_name = "FILE")]
    pub splats: Option<PathBuf>,
    /// Observations as OpenEXR, a layer for each view
    #[arg(long, value_name = "FILE")]
    pub exr: Option<PathBuf>,
    /// Observations as a Zarr store (version 2), which numpy's and xarray's users read
    #[arg(long, value_name = "FOLDER")]
    pub zarr: Option<PathBuf>,
    /// Gamma of the exposure function y = 1 - exp(-gamma x) that splats show [default: half grey for the median]
    #[arg(long, value_parser = super::parse_gamma, conflicts_with_all = ["web", "exr", "zarr"])]
    pub gamma: Option<f32>,
    /// The page's title [default: the first map's name]
    #[arg(long, conflicts_with_all = ["splats", "exr", "zarr"])]
    pub title: Option<String>,
    /// Replace what is there
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Info {
    /// Anything that Rigel has written: a session, lens.toml, registration.toml, observations.rigel, a map, radiance, a response
    pub file: PathBuf,
    /// Write a small picture of it
    #[arg(long, value_name = "FILE")]
    pub png: Option<PathBuf>,
    /// Replace the picture that is there
    #[arg(long)]
    pub force: bool,
}
