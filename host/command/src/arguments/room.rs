//! What can be typed of a room: its map, its lights, its model.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use glam::DVec3;
use rigel::geometry::Texels;
use rigel::units::{parse_part, parse_pixels, parse_quaternion};

/// What is known of photographs taken on the spot.
#[derive(Args)]
pub struct Photographs {
    /// The lens, as `rigel calibrate` or OpenCV wrote it [default: the one in frames.json]
    #[arg(long)]
    pub lens: Option<PathBuf>,
    /// The angle across a photograph, degrees, where there is no lens
    #[arg(long = "fov", value_name = "DEGREES", conflicts_with = "lens")]
    pub fov_deg: Option<f64>,
    /// How sure the orientations are about each axis, degrees, where the file does not say
    #[arg(long = "sigma", value_name = "DEGREES", default_value_t = 2.0)]
    pub sigma_deg: f64,
    /// Take the orientations as they are
    #[arg(long)]
    pub no_refine: bool,
    /// What the photographs' levels are worth: srgb (mended by the exposures if they are stated), linear, or a response.csv
    #[arg(long, default_value = "srgb")]
    pub response: String,
}

#[derive(Args)]
pub struct Mosaic {
    /// Folder with frames.json or frames.csv, or such a file: photographs and how the camera was turned, or when (file,time_s) with a tracker's
    /// records beside them (tracker.jsonl, or tracker.csv with time_s,qw,qx,qy,qz)
    pub shots: PathBuf,
    /// The records of the tracker whose receiver was on the camera [default: those beside the photographs]
    #[arg(long, value_name = "FILE")]
    pub tracker: Option<PathBuf>,
    /// Which receiver was on the camera [default: the only one]
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=2))]
    pub receiver: Option<u8>,
    /// How long before its time a photograph was taken, seconds [default: the photographs tell]
    #[arg(long = "delay", value_name = "SECONDS", allow_negative_numbers = true)]
    pub delay_s: Option<f64>,
    /// How the receiver sits on the camera: the quaternion w,x,y,z that takes the camera's axes (y up) to the receiver's [default: within a
    /// few degrees of straight, the photographs tell]
    #[arg(long, value_name = "W,X,Y,Z", value_parser = parse_quaternion, allow_hyphen_values = true)]
    pub mount: Option<glam::DQuat>,
    /// The map
    #[arg(long, default_value = "map.exr")]
    pub out: PathBuf,
    /// Columns and rows, twice as wide as high
    #[arg(long, default_value = "4096x2048", value_parser = parse_pixels)]
    pub size: Texels,
    #[command(flatten)]
    pub photographs: Photographs,
    /// Fill what was never seen from what is around
    #[arg(long)]
    pub fill: bool,
    /// Write a PNG beside the map, for a look
    #[arg(long)]
    pub png: bool,
    /// Follow the folder while it fills: tell after each photograph what was seen and where to point next, and refresh MAP-coverage.png; begin the
    /// map when everything wanted was seen, or at Ctrl-C. Azimuth 0 is the map's left edge, 90 a quarter to the right, 180 its centre
    #[arg(long)]
    pub live: bool,
    /// With --live: record the tracker at this rig (a port, or simulated) in the folder's tracker.jsonl meanwhile
    #[arg(long, requires = "live", value_name = "PORT", conflicts_with = "tracker")]
    pub rig: Option<String>,
    /// With --live: what lies below this elevation need not be seen, degrees above the horizon
    #[arg(long = "lowest", requires = "live", value_name = "DEGREES", default_value_t = -90.0, allow_negative_numbers = true)]
    pub lowest_deg: f64,
    /// With --live: what lies above this elevation need not be seen
    #[arg(
        long = "highest",
        requires = "live",
        value_name = "DEGREES",
        default_value_t = 90.0,
        allow_negative_numbers = true
    )]
    pub highest_deg: f64,
    /// With --live: how much of the next photograph shows what was seen already
    #[arg(long, requires = "live", default_value = "30%", value_parser = parse_part)]
    pub overlap: f64,
    /// Replace the map that is there, and its pictures
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Update {
    /// The map, by rigel mosaic from photographs whose exposures were stated
    pub map: PathBuf,
    /// Folder with frames.json or frames.csv, or such a file: new photographs by the same camera, with exposure_s
    pub shots: PathBuf,
    /// The map as it is now
    #[arg(long)]
    pub out: PathBuf,
    /// The map is in the unit of these photographs, though it does not say so
    #[arg(long)]
    pub same_unit: bool,
    /// A change of the light, or of a lamp beside it, counts from this part on, and from three standard deviations on
    #[arg(long, default_value = "2%", value_parser = parse_part)]
    pub threshold: f64,
    #[command(flatten)]
    pub photographs: Photographs,
    /// Replace the map that is there
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Lights {
    /// A latitude-longitude map: rigel mosaic's, or any OpenEXR or Radiance HDR picture twice as wide as high
    pub map: PathBuf,
    /// The table of lights [default: the map's name with -lights.csv]
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// How far the irradiance may be off, open and behind walls (root mean square, a part of it)
    #[arg(long, default_value = "5%", value_parser = parse_part)]
    pub tolerance: f64,
    /// No more lights than these
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u16).range(1..=512))]
    pub most: u16,
    /// How they are found: joined (above the median radiance, the rest smooth: harmonics up to order 2), or median-cut (Debevec's, for comparison)
    #[arg(long, value_enum, default_value = "joined")]
    pub method: LightMethod,
    /// Replace the table that is there
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Cube {
    /// A latitude-longitude map: rigel mosaic's, or any OpenEXR or Radiance HDR picture twice as wide as high
    pub map: PathBuf,
    /// Folder for px, nx, py, ny, pz and nz, laid out as OpenGL, Vulkan and WebGPU have them
    #[arg(long, default_value = "cube")]
    pub out: PathBuf,
    /// Pixels along a face's side [default: a quarter of the map's width]
    #[arg(long)]
    pub size: Option<u32>,
    /// Replace the faces that are there
    #[arg(long)]
    pub force: bool,
}

#[derive(Args)]
pub struct Room {
    /// The room: .obj, .gltf or .glb, lengths in metres
    pub model: PathBuf,
    /// A latitude-longitude map; several may follow
    #[arg(long, required = true)]
    pub map: Vec<PathBuf>,
    /// Where it was taken, in the model's frame, metres; one for each map
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pub centre: Vec<DVec3>,
    /// Points of the model that were found in it, which tell its turn and, without --centre, its place: a table with the columns
    /// px,py,pz and dx,dy,dz or column,row; one for each map [default: the map's axes are the model's]
    #[arg(long, value_name = "CSV")]
    pub pairs: Vec<PathBuf>,
    /// Folder for the room with its texture, and its light sources
    #[arg(long, default_value = "room")]
    pub out: PathBuf,
    /// Texels along the texture's side
    #[arg(long, default_value_t = 1024)]
    pub size: u32,
    /// Fill what no map has seen from what is around
    #[arg(long)]
    pub fill: bool,
    /// Also write look.exr, the map that a camera would see at this place
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pub look: Option<DVec3>,
    /// Replace what is there
    #[arg(long)]
    pub force: bool,
}

/// A point: three numbers, metres.
fn parse_point(text: &str) -> Result<DVec3, String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|number| number.trim().parse().ok()).collect();
    match numbers[..] {
        [x, y, z] if text.split(',').count() == 3 && [x, y, z].iter().all(|x| x.is_finite()) => {
            Ok(DVec3::new(x, y, z))
        }
        _ => Err("give three numbers in metres, such as 1.2,1.5,-0.4".into()),
    }
}

#[derive(Clone, Copy, ValueEnum)]
pub enum LightMethod {
    Joined,
    MedianCut,
}
