//! Observations for programs that read arrays: a Zarr store (version 2), a folder with a file for each chunk.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use serde_json::{Value, json};

use super::ObservationMap;
use crate::file::{replace_folder, sync_folder_of};
use crate::progress::Progress;
use crate::{Error, Result};

/// The names of a store's files.
const GROUP: &str = ".zgroup";
const ARRAY: &str = ".zarray";
const ATTRIBUTES: &str = ".zattrs";
/// The attribute that tells these stores from those of other programs.
pub(crate) const MADE_BY: &str = "made_by";
/// Of zlib: the fastest that compresses; noise does not get much smaller.
const LEVEL: u8 = 1;
/// No side of an array that Rigel wrote is longer.
const MOST: usize = 1 << 14;
const ORDER: char = if cfg!(target_endian = "big") { '>' } else { '<' };
/// xarray's name for the names of an array's axes.
const DIMENSIONS: &str = "_ARRAY_DIMENSIONS";

/// Whether a folder is a Zarr store.
pub(crate) fn is_store(path: &Path) -> bool {
    path.join(GROUP).is_file()
}

/// A store's attributes, where Rigel has written it.
pub(crate) fn attributes(path: &Path) -> Option<Value> {
    let bytes = fs::read(path.join(ATTRIBUTES)).ok().filter(|_| is_store(path))?;
    let about: Value = serde_json::from_slice(&bytes).ok()?;
    let is_ours = about[MADE_BY].as_str().is_some_and(|name| name.starts_with("rigel "));
    is_ours.then_some(about)
}

/// Columns, rows, and what the views of a store that Rigel wrote measured on average, texel by texel: 0 where none did.
///
/// # Errors
/// [`Error::Io`]; [`Error::Input`] when the store is damaged.
pub(crate) fn mean(path: &Path) -> Result<(u32, u32, Vec<[f32; 3]>)> {
    let radiance = path.join("radiance");
    let damaged = |what: String| Error::input(path, what, "export it again");
    let read = |name: &str| fs::read(radiance.join(name)).map_err(Error::io("read", radiance.join(name)));
    let meta: Value = serde_json::from_slice(&read(ARRAY)?)
        .map_err(|error| damaged(format!("does not say its shape ({error})")))?;
    let sides = |name: &str| {
        let sides: Vec<usize> =
            meta[name].as_array().into_iter().flatten().filter_map(|n| Some(n.as_u64()? as usize)).collect();
        let are_usable = |sides: &[usize; 4]| sides.iter().all(|side| (1..=MOST).contains(side));
        <[usize; 4]>::try_from(sides).ok().filter(are_usable)
    };
    let is_ours = |(shape, chunk): &([usize; 4], [usize; 4])| {
        shape[2..] == chunk[2..] && shape[3] == 3 && meta["dtype"].as_str() == Some(&format!("{ORDER}f4"))
    };
    // Another program may have changed them.
    let Some(([rows, columns, views, _], chunk)) = sides("shape").zip(sides("chunks")).filter(is_ours) else {
        return Err(damaged("has no radiance (row, column, view, channel)".into()));
    };
    let mut means = vec![[0.0; 3]; rows * columns];
    for (down, right) in (0..rows.div_ceil(chunk[0]))
        .flat_map(|down| (0..columns.div_ceil(chunk[1])).map(move |right| (down, right)))
    {
        let (name, length) = (format!("{down}.{right}.0.0"), 4 * chunk.iter().product::<usize>());
        let bytes = miniz_oxide::inflate::decompress_to_vec_zlib_with_limit(&read(&name)?, length);
        let values: Vec<f32> = bytes.ok().filter(|bytes| bytes.len() == length).map_or_else(
            || Err(damaged(format!("holds a damaged piece (radiance/{name})"))),
            |bytes| Ok(bytemuck::pod_collect_to_vec(&bytes)),
        )?;
        for (slot, seen) in values.chunks_exact(3 * views).enumerate() {
            let (row, column) = (down * chunk[0] + slot / chunk[1], right * chunk[1] + slot % chunk[1]);
            if row < rows && column < columns {
                let seen = seen.chunks_exact(3).filter(|l| !l[0].is_nan());
                let (sum, count) =
                    seen.fold(([0.0; 3], 0), |(sum, n), l| (std::array::from_fn(|c| sum[c] + l[c]), n + 1));
                means[row * columns + column] = sum.map(|sum: f32| sum / count.max(1) as f32);
            }
        }
    }
    Ok((columns as u32, rows as u32, means))
}

impl ObservationMap {
    /// Writes a Zarr store (version 2, zlib): `radiance` (row, column, view, channel) and `sigma` (row, column, view) as 32-bit floats,
    /// not a number where a view measured nothing, a tile of the map in each chunk; `centre` (view, axis; metres), `x` (column) and `y`
    /// (row; metres) as 64-bit floats; names and units as attributes. Such a store is replaced where it stands there. `progress` counts tiles.
    ///
    /// # Errors
    /// [`Error::Input`] when something else stands there; [`Error::Io`]; [`Error::Interrupted`].
    pub fn write_zarr(&self, path: &Path, progress: &dyn Progress) -> Result<()> {
        if path.exists() && attributes(path).is_none() {
            return Err(Error::input(
                path,
                "is there already, and is no Zarr store that Rigel wrote",
                "choose another name, or delete it",
            ));
        }
        let header = self.header();
        let (texels, tile, views) = (header.texels, header.tile, header.views.len());
        let size = |columns: u32, rows: u32| [rows as usize, columns as usize];
        let (all, chunk) = (size(texels.columns, texels.rows), size(tile.columns, tile.rows));
        let names: Vec<&str> = header.views.iter().map(|view| view.name.as_str()).collect();
        let about = json!({
            MADE_BY: concat!("rigel ", env!("CARGO_PKG_VERSION")),
            "about": "what each view measured of each texel of a surface: x right, y up, z out of it; row 0 is the top one",
            "surface_m": [header.surface.width_m, header.surface.height_m],
            "views": names,
        });
        let centres = header.views.iter().flat_map(|view| view.centre_m.to_array()).collect();
        let centre = |column, row| header.surface.texel_centre(texels, column, row);
        replace_folder(path, |folder| {
            let store = Store { folder, path };
            store.make("")?;
            store.json(GROUP, &json!({ "zarr_format": 2 }))?;
            store.json(ATTRIBUTES, &about)?;
            let radiance = json!({ DIMENSIONS: ["row", "column", "view", "channel"], "units": "the session's radiance, linear, channels R G B" });
            store.array(
                "radiance",
                "f4",
                &[&all[..], &[views, 3]].concat(),
                &[&chunk[..], &[views, 3]].concat(),
                &radiance,
            )?;
            let sigma =
                json!({ DIMENSIONS: ["row", "column", "view"], "units": "standard deviation, as radiance" });
            store.array(
                "sigma",
                "f4",
                &[&all[..], &[views]].concat(),
                &[&chunk[..], &[views]].concat(),
                &sigma,
            )?;
            let metres = |dimensions: &[&str], what: &str| json!({ DIMENSIONS: dimensions, "units": "m", "long_name": what });
            store.whole("centre", &[views, 3], centres, &metres(&["view", "axis"], "of the camera"))?;
            store.whole(
                "x",
                &all[1..],
                (0..texels.columns).map(|i| centre(i, 0).x).collect(),
                &metres(&["column"], "of the texels"),
            )?;
            store.whole(
                "y",
                &all[..1],
                (0..texels.rows).map(|i| centre(0, i).y).collect(),
                &metres(&["row"], "of the texels"),
            )?;
            let gains = header.views.iter().map(|view| view.gain).collect();
            store.whole(
                "gain",
                &[views],
                gains,
                &json!({ DIMENSIONS: ["view"], "long_name": "the radiance was divided by it" }),
            )?;
            let (tiles, done) = (header.tiles(), AtomicUsize::new(0));
            (0..tiles.count()).into_par_iter().try_for_each(|number| {
                progress.step(done.fetch_add(1, Ordering::Relaxed), tiles.count())?;
                let [radiance, sigma] = self.chunk(number)?;
                let at = [number as u32 / tiles.columns, number as u32 % tiles.columns];
                store.chunk(&format!("radiance/{}.{}.0.0", at[0], at[1]), &radiance)?;
                store.chunk(&format!("sigma/{}.{}.0", at[0], at[1]), &sigma)
            })?;
            progress.step(tiles.count(), tiles.count())?;
            // The names of the files in each folder.
            [GROUP, "radiance/0", "sigma/0", "centre/0", "x/0", "y/0", "gain/0"]
                .iter()
                .try_for_each(|name| sync_folder_of(&folder.join(name)).map_err(Error::io("write", path)))
        })
    }

    /// One tile's radiance and its standard deviation: texel by texel, view by view.
    fn chunk(&self, number: usize) -> Result<[Vec<f32>; 2]> {
        let (tile, views) = (self.header().tile, self.header().views.len());
        let mut sigma = vec![f32::NAN; tile.count() * views];
        let mut radiance = vec![f32::NAN; 3 * sigma.len()];
        for ((column, row), texel) in self.tile(number)? {
            let slot = (row % tile.rows * tile.columns + column % tile.columns) as usize;
            for (i, view) in texel.view.iter().enumerate() {
                let place = slot * views + *view as usize;
                sigma[place] = texel.sigma[i];
                radiance[3 * place..3 * place + 3].copy_from_slice(&texel.radiance[i]);
            }
        }
        Ok([radiance, sigma])
    }
}

/// A store that is being written.
struct Store<'a> {
    folder: &'a Path,
    /// Where it will be.
    path: &'a Path,
}

impl Store<'_> {
    fn make(&self, name: &str) -> Result<()> {
        fs::create_dir(self.folder.join(name)).map_err(Error::io("create", self.path.join(name)))
    }

    fn file(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let written = fs::File::create(self.folder.join(name))
            .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()));
        written.map_err(Error::io("write", self.path.join(name)))
    }

    fn json(&self, name: &str, value: &Value) -> Result<()> {
        self.file(name, value.to_string().as_bytes())
    }

    /// An array without its chunks.
    fn array(&self, name: &str, kind: &str, shape: &[usize], chunks: &[usize], about: &Value) -> Result<()> {
        self.make(name)?;
        let meta = json!({
            "zarr_format": 2, "shape": shape, "chunks": chunks, "dtype": format!("{ORDER}{kind}"), "order": "C", "fill_value": "NaN", "filters": null,
            "compressor": { "id": "zlib", "level": LEVEL },
        });
        self.json(&format!("{name}/{ARRAY}"), &meta)?;
        self.json(&format!("{name}/{ATTRIBUTES}"), about)
    }

    /// An array in one chunk.
    fn whole(&self, name: &str, shape: &[usize], values: Vec<f64>, about: &Value) -> Result<()> {
        self.array(name, "f8", shape, shape, about)?;
        self.chunk(&format!("{name}/{}", vec!["0"; shape.len()].join(".")), &values)
    }

    fn chunk<T: bytemuck::NoUninit>(&self, name: &str, values: &[T]) -> Result<()> {
        self.file(name, &miniz_oxide::deflate::compress_to_vec_zlib(bytemuck::cast_slice(values), LEVEL))
    }
}
