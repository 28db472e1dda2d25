//! prototype
#![allow(missing_docs, clippy::all, clippy::unwrap_used)]
use glam::{DVec3, Vec3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;
use rigel::fit::{Evidence, FitOptions, Fitter, Model, candidates, choose_models};
use rigel::geometry::Texels;
use rigel::observation::TexelObservations;
use rigel::render::expose;
use rigel::sampling::{icosphere, spiral, stratified};
use rigel_simulated::scene::Scene;

const LIMIT: f64 = 75.0;
const DISTANCE: f64 = 0.9;

struct World {
    points: Vec<DVec3>,
    texels: Texels,
    scene: Scene,
    fresh: Vec<DVec3>,
    fresh_truth: Vec<[f32; 3]>, // texel-major
    gamma: f32,
    floor: f32,
}

fn normal(r: &mut StdRng) -> f32 {
    let (a, b): (f32, f32) = (r.random(), r.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f32::consts::TAU * b).cos()
}

fn hash(d: DVec3) -> u64 {
    let mut h = 1469598103934665603u64;
    for v in d.to_array() {
        h = (h ^ v.to_bits()).wrapping_mul(1099511628211); h ^= h >> 29;
    }
    h
}

impl World {
    fn new(columns: u32, rows: u32, fresh: usize) -> Self {
        let scene = Scene::patchwork();
        let texels = Texels { columns, rows };
        let points: Vec<DVec3> = (0..rows)
            .flat_map(|r| (0..columns).map(move |c| (c, r)))
            .map(|(c, r)| scene.surface().texel_centre(texels, c, r))
            .collect();
        let fresh = stratified(fresh, LIMIT.to_radians(), 99).unwrap();
        let fresh_truth: Vec<[f32; 3]> = road(&scene, &fresh, texels, false).into_iter().flat_map(|t| { assert_eq!(t.len(), fresh.len()); t.radiance }).collect();
        let mut all: Vec<f32> = fresh_truth.iter().flatten().copied().collect();
        let gamma = rigel::render::gamma_for_median(&all).unwrap();
        all.sort_by(f32::total_cmp);
        let floor = 0.05 * all[all.len() / 2];
        Self { points, texels, scene, fresh, fresh_truth, gamma, floor }
    }

    fn observe(&self, views: &[DVec3]) -> Vec<TexelObservations> {
        road(&self.scene, views, self.texels, true)
    }

    /// mean255, relative %, rmse, psnr
    fn error(&self, fits: &[(Model, Vec<f32>)]) -> [f64; 3] {
        let n = self.fresh.len();
        let sums = fits
            .par_iter()
            .enumerate()
            .map(|(t, (model, parameters))| {
                let mut sum = [0.0f64; 3];
                for (f, truth) in self.fresh.iter().zip(&self.fresh_truth[t * n..]) {
                    let d = (*f * DISTANCE - self.points[t]).normalize().as_vec3();
                    let got = model.radiance(parameters, d);
                    for c in 0..3 {
                        let (a, b) = (got[c], truth[c]);
                        sum[0] += f64::from((expose(a, self.gamma) - expose(b, self.gamma)).abs());
                        sum[1] += f64::from(((a - b).abs() / (b + self.floor)).min(1.0));
                        sum[2] += f64::from((expose(a, self.gamma) - expose(b, self.gamma)).powi(2));
                    }
                }
                sum
            })
            .reduce(|| [0.0; 3], |a, b| std::array::from_fn(|i| a[i] + b[i]));
        let count = (3 * n * fits.len()) as f64;
        [255.0 * sums[0] / count, 100.0 * sums[1] / count, 255.0 * (sums[2] / count).sqrt()]
    }

    fn fit(&self, observed: &[TexelObservations], name: &str) -> Vec<(Model, Vec<f32>)> {
        let options = FitOptions::default();
        let stride = (observed.len() / 400).max(1);
        let sample: Vec<_> = observed.iter().step_by(stride).cloned().collect();
        if name == "auto" {
            let mut fitters: Vec<Fitter> =
                candidates().into_iter().filter_map(|m| Fitter::new(m, &options, &sample).ok()).collect();
            fitters.sort_by_key(|f| f.model().bytes_per_texel());
            // as select_surface shortens
            let few: Vec<_> = sample.iter().step_by(4).collect();
            let chosen: Vec<usize> = few
                .par_iter()
                .filter_map(|t| Evidence::of(&fitters, t).choices(0.0))
                .map(|[_, o]| o)
                .collect();
            let mut k = 0;
            fitters.retain(|_| {
                let share = chosen.iter().filter(|c| **c == k).count() as f64 / chosen.len() as f64;
                k += 1;
                share >= 0.03
            });
            let evidence: Vec<_> = observed.par_iter().map(|t| Evidence::of(&fitters, t)).collect();
            let sizes: Vec<usize> = fitters.iter().map(|f| f.model().bytes_per_texel()).collect();
            let choice = choose_models(&evidence, self.texels, &sizes, 0.0);
            return observed
                .par_iter()
                .zip(choice)
                .map(|(t, (c, _))| (fitters[c].model(), fitters[c].fit(t).parameters))
                .collect();
        }
        let model = Model::parse(name).unwrap();
        let fitter = Fitter::new(model, &options, &sample).unwrap();
        observed.par_iter().map(|t| (model, fitter.fit(t).parameters)).collect()
    }

    fn report(&self, what: &str, views: &[DVec3], models: &[&str]) {
        let mut observed = self.observe(views);
        if let Ok(power) = std::env::var("WEIGH") {
            let power: f64 = power.parse().unwrap();
            let lattice = spiral(8000, LIMIT.to_radians()).unwrap();
            let mut area = vec![0.0f64; views.len()];
            for l in &lattice { let b = (0..views.len()).max_by(|&a, &b| views[a].dot(*l).total_cmp(&views[b].dot(*l))).unwrap(); area[b] += 1.0; }
            let most = { let mut a = area.clone(); a.sort_by(f64::total_cmp); a[a.len() * 95 / 100] };
            for t in &mut observed { for i in 0..t.len() {
                let a = (area[t.view[i] as usize].max(1.0) / most).min(1.0).powf(power);
                let mean = f64::from(t.radiance[i].iter().sum::<f32>() / 3.0);
                let var = f64::from(t.sigma[i]).powi(2) + (0.03 * mean).powi(2) + f64::from(self.floor).powi(2);
                t.sigma[i] = (var / a - var + f64::from(t.sigma[i]).powi(2)).sqrt() as f32;
            } }
        }
        print!("{what:<28} {:>4}", views.len());
        for m in models {
            let e = self.error(&self.fit(&observed, m));
            print!("  {m}: {:.3} /255 {:.2} % rms {:.2}", e[0], e[1], e[2]);
        }
        println!();
    }
}

fn road(scene: &Scene, views: &[DVec3], texels: Texels, noise: bool) -> Vec<TexelObservations> {
    use rigel::geometry::Pose;
    use rigel::session::{Event, Manifest, Photograph, Session, View};
    use rigel_simulated::camera::{self, SimulatedCamera};
    let options = camera::Options::default();
    let folder = tempfile::tempdir_in("/tmp/plan").unwrap();
    let cache = std::path::PathBuf::from("/tmp/plan/cache");
    std::fs::create_dir_all(&cache).unwrap();
    let mut manifest = Manifest::new("test");
    manifest.surface = Some(scene.surface());
    manifest.distance_m = Some(DISTANCE);
    manifest.lenses = vec![options.lens];
    let angles: Vec<(f64, f64)> = views.iter().map(|v| rigel::sampling::pan_tilt(*v)).collect();
    manifest.views = angles.iter().enumerate().map(|(i, (p, t))| View { name: format!("view{i:03}"), pan_deg: Some(p.to_degrees()), tilt_deg: Some(t.to_degrees()), lens: 0, pose: None }).collect();
    let mut session = Session::create(&folder.path().join("s"), manifest).unwrap();
    std::fs::create_dir(session.radiance_folder()).unwrap();
    views.par_iter().zip(&angles).for_each(|(v, (pan, tilt))| {
        let file = cache.join(format!("{:x}{}.exr", hash(*v), noise));
        if file.exists() { return; }
        let pose = Pose::from_rig(*pan, *tilt, DISTANCE);
        let camera = SimulatedCamera::new(scene.clone(), options, || (0.0, 0.0));
        let mut image = camera.truth(&pose);
        let mut r = StdRng::seed_from_u64(hash(*v));
        for (l, v) in image.radiance.iter_mut().zip(&mut image.variance) {
            for c in 0..3 {
                let s = (0.013 * l[c]).hypot(0.002);
                v[c] = s * s;
                if noise { l[c] = (l[c] + s * normal(&mut r)).max(0.0); }
            }
        }
        image.write_exr(&file, "test").unwrap();
    });
    for (i, v) in views.iter().enumerate() {
        let photograph = Photograph { view: i, file: format!("photographs/{i}.png"), exposure_s: Some(1.0), ..Photograph::default() };
        session.record(Event::Photograph(photograph)).unwrap();
        session.record(Event::ViewDone { view: i }).unwrap();
        std::fs::hard_link(cache.join(format!("{:x}{}.exr", hash(*v), noise)), session.radiance_path(i)).unwrap();
    }
    let map = rigel::observation::observe(&session, &folder.path().join("o.rigel"), &rigel::observation::Options { texels }, &rigel::progress::Silent).unwrap();
    let mut out = vec![TexelObservations::default(); texels.count()];
    for tile in 0..map.header().tiles().count() {
        for ((c, r), t) in map.tile(tile).unwrap() { out[(r * texels.columns + c) as usize] = t; }
    }
    out
}

struct Lobe { d: Vec3, m: f32, ks: f32 }

/// Ways in which texels may be wrong
struct Ways {
    k: usize,
    at: Vec<f32>,     // G x K, candidates
    p: Vec<f64>,      // K x K
    s2: Vec<f32>,     // noise var at candidates
}

fn rank_one(p: &mut [f64], k: usize, a: &[f32], s2: f64) {
    let mut pa = vec![0.0; k];
    for i in 0..k { for j in 0..k { pa[i] += p[i * k + j] * f64::from(a[j]); } }
    let q: f64 = pa.iter().zip(a).map(|(x, y)| x * f64::from(*y)).sum::<f64>() + s2;
    for i in 0..k { for j in 0..k { p[i * k + j] -= pa[i] * pa[j] / q; } }
}

struct Recipe { hidden: usize, anywhere: usize, tone: bool, noise: f32, params: bool, amplitude: f32 }

fn plan_ways(world: &World, observed: &[TexelObservations], candidates_: &[DVec3], count: usize, model: &str, recipe: &Recipe) -> Vec<DVec3> {
    let stride = (observed.len() / 500).max(1) | 1;
    let chosen: Vec<usize> = (0..observed.len()).step_by(stride).collect();
    let fits = {
        let obs: Vec<_> = chosen.iter().map(|&i| observed[i].clone()).collect();
        let m = Model::parse(model).unwrap();
        let fitter = Fitter::new(m, &FitOptions::default(), &obs).unwrap();
        obs.par_iter().map(|t| (m, fitter.fit(t))).collect::<Vec<_>>()
    };
    let floor = world.floor;
    let gamma = world.gamma;
    let tone = |l: f32| if recipe.tone { expose(l, gamma) } else { (l.max(0.0) + floor).ln() };
    // pool of lobes
    let pool: Vec<Lobe> = fits.iter().flat_map(|(_, f)| f.parameters[3..].chunks_exact(7).map(|l| Lobe {
        ks: (l[0] + l[1] + l[2]) / 3.0, m: l[3], d: Vec3::new(l[4], l[5], l[6]) }).collect::<Vec<_>>())
        .filter(|l| l.ks > 0.1 * floor && l.d.z > 0.0).collect();
    let g = candidates_.len();
    let white = |p: &[f32]| -> Vec<f32> {
        let mut out = vec![(p[0] + p[1] + p[2]) / 3.0];
        for l in p[3..].chunks_exact(7) { out.extend([(l[0] + l[1] + l[2]) / 3.0, l[3], l[4], l[5], l[6]]); }
        out
    };
    let eval = |p: &[f32], d: Vec3| -> f32 {
        let mut s = p[0];
        for l in p[1..].chunks_exact(5) {
            let n = Vec3::new(l[2], l[3], l[4]).normalize();
            s += l[0] * n.dot(d).clamp(0.0, 1.0).powf(l[1]);
        }
        s
    };
    let mut ways: Vec<Ways> = fits.par_iter().enumerate().map(|(n, (_, fit))| {
        let t = chosen[n];
        let point = world.points[t];
        let mut r = StdRng::seed_from_u64(n as u64);
        let base = white(&fit.parameters);
        let mut variants: Vec<Vec<f32>> = vec![];
        if recipe.params {
            let mut v = base.clone(); v[0] = v[0] * 1.5 + 0.0; variants.push(v);
            for l in 0..(base.len() - 1) / 5 {
                let o = 1 + 5 * l;
                if base[o] <= 0.0 { continue; }
                let mut v = base.clone(); v[o] *= 2.0; variants.push(v);
                let mut v = base.clone(); v[o + 1] *= 1.5; variants.push(v);
                let d = Vec3::new(base[o + 2], base[o + 3], base[o + 4]);
                let (a, b) = d.any_orthonormal_pair();
                let step = (0.5 / base[o + 1].max(1.0)).sqrt().min(0.3);
                for x in [a, b] {
                    let e = (d + x * step).normalize();
                    let mut v = base.clone();
                    v[o + 2..o + 5].copy_from_slice(&e.to_array());
                    variants.push(v);
                }
            }
        }
        if !pool.is_empty() {
            for _ in 0..recipe.hidden {
                let l = &pool[r.random_range(0..pool.len())];
                let mut v = base.clone();
                // sharper than was seen, too
                let m = l.m * r.random_range(0.0..1.0f32).exp();
                v.extend([l.ks * recipe.amplitude, m.min(2000.0), l.d.x, l.d.y, l.d.z]);
                variants.push(v);
            }
        }
        for _ in 0..recipe.anywhere {
            let z = r.random_range(LIMIT.to_radians().cos() as f32..1.0);
            let az = r.random_range(0.0..std::f32::consts::TAU);
            let q = (1.0 - z * z).sqrt();
            let ks = 0.3 * base[0].max(floor);
            let mut v = base.clone();
            v.extend([ks, 60.0, q * az.cos(), q * az.sin(), z]);
            variants.push(v);
        }
        let k = variants.len();
        let toward = |d: Vec3| -> (Vec<f32>, f32) {
            let l = eval(&base, d);
            let y = tone(l);
            let slope = if recipe.tone { gamma * (-gamma * l).exp() } else { 1.0 / (l + floor) };
            let s = slope * (recipe.noise * l).hypot(recipe.noise * floor) + 1e-3;
            (variants.iter().map(|v| tone(eval(v, d)) - y).collect(), s * s)
        };
        let mut p = vec![0.0; k * k];
        for i in 0..k { p[i * k + i] = 1.0; }
        for d in &observed[t].direction {
            let (a, s2) = toward(*d);
            rank_one(&mut p, k, &a, f64::from(s2));
        }
        let mut at = Vec::with_capacity(k * g);
        let mut s2s = vec![];
        for c in candidates_ {
            let (a, s2) = toward((*c * DISTANCE - point).normalize().as_vec3());
            at.extend(a);
            s2s.push(s2);
        }
        Ways { k, at, p, s2: s2s }
    }).collect();
    let mut out = vec![];
    let expected = |ways: &[Ways]| -> f64 {
        ways.par_iter().map(|w| {
            let k = w.k;
            (0..g).map(|c| { let a = &w.at[c * k..][..k];
                let mut q = 0.0; for i in 0..k { for j in 0..k { q += w.p[i * k + j] * f64::from(a[i] * a[j]); } } q }).sum::<f64>() / g as f64
        }).sum::<f64>() / ways.len() as f64
    };
    print!("    expected {:.4}", expected(&ways).sqrt());
    for _ in 0..count {
        let gains = ways.par_iter().map(|w| {
            let k = w.k;
            // W = sum a a^T
            let mut ww = vec![0.0f64; k * k];
            for c in 0..g { let a = &w.at[c * k..][..k]; for i in 0..k { for j in 0..=i { ww[i * k + j] += f64::from(a[i] * a[j]); } } }
            for i in 0..k { for j in 0..i { ww[j * k + i] = ww[i * k + j]; } }
            let mul = |a: &[f64], b: &[f64]| { let mut o = vec![0.0; k * k]; for i in 0..k { for l in 0..k { let x = a[i * k + l]; for j in 0..k { o[i * k + j] += x * b[l * k + j]; } } } o };
            let pwp = mul(&mul(&w.p, &ww), &w.p);
            (0..g).map(|c| {
                let a = &w.at[c * k..][..k];
                let (mut q, mut up) = (f64::from(w.s2[c]), 0.0);
                for i in 0..k { let (mut x, mut y) = (0.0, 0.0); for j in 0..k { x += pwp[i * k + j] * f64::from(a[j]); y += w.p[i * k + j] * f64::from(a[j]); } up += x * f64::from(a[i]); q += y * f64::from(a[i]); }
                (up / q) / g as f64
            }).collect::<Vec<f64>>()
        }).reduce(|| vec![0.0; g], |a, b| a.iter().zip(&b).map(|(x, y)| x + y).collect());
        let best = (0..g).max_by(|&a, &b| gains[a].total_cmp(&gains[b])).unwrap();
        out.push(candidates_[best]);
        ways.par_iter_mut().for_each(|w| { let k = w.k; let a = w.at[best * k..][..k].to_vec(); let s2 = f64::from(w.s2[best]); rank_one(&mut w.p, k, &a, s2); });
    }
    println!(" -> {:.4}", expected(&ways).sqrt());
    out
}

/// kriging with an amplitude learnt from held-out views
fn plan_kriging(world: &World, observed: &[TexelObservations], views: &[DVec3], candidates_: &[DVec3], count: usize, model: &str, length_rad: f64) -> Vec<DVec3> {
    let stride = (observed.len() / 500).max(1) | 1;
    let obs: Vec<_> = observed.iter().step_by(stride).cloned().collect();
    let m = Model::parse(model).unwrap();
    let fitter = Fitter::new(m, &FitOptions::default(), &obs).unwrap();
    let n = views.len();
    let e2 = obs.par_iter().map(|t| {
        let mut e = vec![0.0f64; n];
        for part in 0..8u32 {
            let held: Vec<u32> = (0..n as u32).filter(|v| (v * 5) % 8 == part).collect();
            let fit = fitter.fit(&t.without(&held));
            for &v in &held { let v = v as usize;
                let got = m.radiance(&fit.parameters, t.direction[v]);
                for c in 0..3 { e[v] += f64::from(expose(got[c], world.gamma) - expose(t.radiance[v][c], world.gamma)).powi(2); }
            }
        }
        e
    }).reduce(|| vec![0.0; n], |a, b| a.iter().zip(&b).map(|(x, y)| x + y).collect());
    let g = candidates_.len();
    let smooth = (4.66f64 / 40.0).sqrt() * 0.6;
    let kernel = |a: DVec3, b: DVec3, l: f64| { let t = a.dot(b).clamp(-1.0, 1.0).acos() / l; (-0.5 * t * t).exp() };
    // nearest-weighted
    let amp: Vec<f64> = candidates_.iter().map(|c| {
        let (mut s, mut w) = (0.0, 1e-9);
        for (v, e) in views.iter().zip(&e2) { let k = kernel(*c, *v, smooth); s += k * e; w += k; }
        (s / w).sqrt()
    }).collect();
    let mut cov: Vec<f64> = vec![0.0; g * g];
    let mean = amp.iter().map(|a| a * a).sum::<f64>() / g as f64;
    for i in 0..g { for j in 0..g { cov[i * g + j] = amp[i] * amp[j] * kernel(candidates_[i], candidates_[j], length_rad); } }
    let noise = 0.02 * mean;
    let update = |cov: &mut Vec<f64>, b: usize| {
        let col: Vec<f64> = (0..g).map(|i| cov[i * g + b]).collect();
        let q = col[b] + noise;
        cov.par_chunks_mut(g).enumerate().for_each(|(i, row)| { for j in 0..g { row[j] -= col[i] * col[j] / q; } });
    };
    for v in views {
        let b = (0..g).max_by(|&a, &b| candidates_[a].dot(*v).total_cmp(&candidates_[b].dot(*v))).unwrap();
        update(&mut cov, b);
    }
    let mut out = vec![];
    for _ in 0..count {
        let gains: Vec<f64> = cov.par_chunks(g).enumerate().map(|(i, row)| row.iter().map(|x| x * x).sum::<f64>() / (row[i] + noise)).collect();
        let best = (0..g).max_by(|&a, &b| gains[a].total_cmp(&gains[b])).unwrap();
        out.push(candidates_[best]);
        update(&mut cov, best);
    }
    out
}

/// density: importance (gradient) x distance to nearest
fn plan_density(world: &World, observed: &[TexelObservations], views: &[DVec3], candidates_: &[DVec3], count: usize, model: &str, power: f64) -> Vec<DVec3> {
    let stride = (observed.len() / 500).max(1) | 1;
    let obs: Vec<_> = observed.iter().step_by(stride).cloned().collect();
    let m = Model::parse(model).unwrap();
    let fitter = Fitter::new(m, &FitOptions::default(), &obs).unwrap();
    let g = candidates_.len();
    let imp = obs.par_iter().map(|t| {
        let fit = fitter.fit(t);
        candidates_.iter().map(|c| {
            let d = c.as_vec3();
            let (a, b) = d.any_orthonormal_pair();
            let y = |d: Vec3| { let l = m.radiance(&fit.parameters, d.normalize()); expose((l[0] + l[1] + l[2]) / 3.0, world.gamma) };
            let h = 0.04;
            f64::from(((y(d + a * h) - y(d - a * h)).powi(2) + (y(d + b * h) - y(d - b * h)).powi(2)) / (4.0 * h * h))
        }).collect::<Vec<f64>>()
    }).reduce(|| vec![0.0; g], |a, b| a.iter().zip(&b).map(|(x, y)| x + y).collect());
    let mean = imp.iter().sum::<f64>() / g as f64;
    let imp: Vec<f64> = imp.iter().map(|i| (i / mean + 0.05).powf(power)).collect();
    let mut all = views.to_vec();
    let mut out = vec![];
    for _ in 0..count {
        let best = (0..g).map(|i| {
            let near = all.iter().map(|v| v.dot(candidates_[i])).fold(-1.0, f64::max).clamp(-1.0, 1.0).acos();
            (i, imp[i] * near)
        }).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap().0;
        all.push(candidates_[best]);
        out.push(candidates_[best]);
    }
    out
}

fn breakdown(world: &World, views: &[DVec3], model: &str) {
    let observed = world.observe(views);
    let fits = world.fit(&observed, model);
    let n = world.fresh.len();
    let mut sums = vec![[0.0f64; 3]; 8];
    let mut bands = vec![[0.0f64; 3]; 12];
    let mut zen = vec![[0.0f64; 3]; 6];
    let mirror = |p: DVec3| { let l = (rigel::geometry::unit_vector(2.2, 0.6) * 0.7 - p).normalize(); DVec3::new(-l.x, -l.y, l.z) };
    let mut models = std::collections::BTreeMap::new();
    let mut per: Vec<(f64, usize)> = vec![];
    for (t, (m, p)) in fits.iter().enumerate() {
        *models.entry(m.name()).or_insert(0) += 1;
        let mut all = 0.0;
        for (f, truth) in world.fresh.iter().zip(&world.fresh_truth[t * n..]) {
            let d = (*f * DISTANCE - world.points[t]).normalize();
            let got = m.radiance(p, d.as_vec3());
            let e: f64 = (0..3).map(|c| f64::from((expose(got[c], world.gamma) - expose(truth[c], world.gamma)).abs())).sum::<f64>() / 3.0 * 255.0;
            let patch = world.scene.patch(world.points[t]).unwrap();
            let band = (mirror(world.points[t]).angle_between(d).to_degrees() / 8.0) as usize;
            let z = (rigel::geometry::azimuth_zenith(d).1.to_degrees() / 15.0) as usize;
            for (v, i) in [(&mut sums, patch), (&mut bands, band.min(11)), (&mut zen, z.min(5))] { v[i][0] += e; v[i][1] += e * e; v[i][2] += 1.0; }
            all += e;
        }
        per.push((all / n as f64, t));
    }
    println!("{} views {model} {models:?}", views.len());
    for (name, v) in [("patch", &sums), ("mirror band 8 deg", &bands), ("zenith 15", &zen)] {
        println!("  {name}: {:?}", v.iter().map(|s| format!("{:.2}/{:.1}", s[0] / s[2], (s[1] / s[2]).sqrt())).collect::<Vec<_>>());
    }
    per.sort_by(|a, b| b.0.total_cmp(&a.0));
    let total: f64 = per.iter().map(|p| p.0).sum();
    let mut acc = 0.0;
    for (i, p) in per.iter().enumerate() { acc += p.0; if [30, 100, 300, 600, 1500].contains(&i) { println!("  worst {i} texels hold {:.0} % of error", 100.0 * acc / total); } }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let models: Vec<&str> = arguments[0].split(',').collect();
    let what = arguments.get(1).map(String::as_str).unwrap_or("all");
    let columns: u32 = arguments.get(2).map_or(64, |c| c.parse().unwrap());
    let world = World::new(columns, columns * 3 / 4, 200);
    println!("gamma {} floor {}", world.gamma, world.floor);
    let limit = LIMIT.to_radians();
    if what == "all" || what == "uniform" {
        if std::env::var("ICO").is_ok() {
        world.report("icosphere within 75", &icosphere(3, limit).unwrap(), &models);
        world.report("icosphere hemisphere", &icosphere(3, std::f64::consts::FRAC_PI_2).unwrap(), &models); return; }
        for n in [40, 60, 80, 100, 150, 200, 305] {
            world.report("uniform spiral", &spiral(n, limit).unwrap(), &models);
        }
        world.report("icosphere within 75", &icosphere(3, limit).unwrap(), &models);
        world.report("icosphere hemisphere", &icosphere(3, std::f64::consts::FRAC_PI_2).unwrap(), &models);
    }
    if what == "breakdown" { for n in [40, 100, 305] { breakdown(&world, &spiral(n, limit).unwrap(), models[0]); } return; }
    let coarse = spiral(std::env::var("COARSE").map_or(40, |c| c.parse().unwrap()), limit).unwrap();
    let grid = spiral(900, limit).unwrap();
    let planner_ = std::env::var("PLANNER").unwrap_or("phong2".into()); let planner = planner_.as_str();
    let mut strategies: Vec<(&str, Box<dyn Fn(&[TexelObservations], &[DVec3], usize) -> Vec<DVec3>>)> = vec![];
    let w = &world;
    let gr = &grid;
    strategies.push(("ways tone", Box::new(move |o, _, n| plan_ways(w, o, gr, n, planner, &Recipe { hidden: 8, anywhere: 4, tone: true, noise: 0.03, params: true, amplitude: 1.0 }))));
    strategies.push(("ways log", Box::new(move |o, _, n| plan_ways(w, o, gr, n, planner, &Recipe { hidden: 8, anywhere: 4, tone: false, noise: 0.03, params: true, amplitude: 1.0 }))));
    strategies.push(("params tone", Box::new(move |o, _, n| plan_ways(w, o, gr, n, planner, &Recipe { hidden: 0, anywhere: 0, tone: true, noise: 0.03, params: true, amplitude: 1.0 }))));
    strategies.push(("hidden tone", Box::new(move |o, _, n| plan_ways(w, o, gr, n, planner, &Recipe { hidden: 12, anywhere: 4, tone: true, noise: 0.03, params: false, amplitude: 1.0 }))));
    strategies.push(("kriging 10", Box::new(move |o, v, n| plan_kriging(w, o, v, gr, n, planner, 0.17))));
    strategies.push(("kriging 20", Box::new(move |o, v, n| plan_kriging(w, o, v, gr, n, planner, 0.35))));
    strategies.push(("density 0.5", Box::new(move |o, v, n| plan_density(w, o, v, gr, n, planner, 0.5))));
    strategies.push(("density 0.25", Box::new(move |o, v, n| plan_density(w, o, v, gr, n, planner, 0.25))));
    strategies.push(("2 ways", Box::new(move |o, _, n| plan_ways(w, o, gr, n, planner, &Recipe { hidden: 3, anywhere: 3, tone: true, noise: 0.03, params: true, amplitude: 0.3 }))));
    strategies.push(("3 ways log", Box::new(move |o, _, n| plan_ways(w, o, gr, n, planner, &Recipe { hidden: 0, anywhere: 0, tone: false, noise: 0.03, params: true, amplitude: 0.3 }))));
    strategies.push(("fill", Box::new(move |o, v, n| plan_density(w, o, v, gr, n, planner, 0.0))));
    strategies.push(("half", Box::new(move |o, v, n| { let mut a = plan_ways(w, o, gr, n / 2, planner, &Recipe { hidden: 0, anywhere: 0, tone: true, noise: 0.03, params: true, amplitude: 1.0 }); let mut all = v.to_vec(); all.extend(&a); a.extend(plan_density(w, o, &all, gr, n - n / 2, planner, 0.0)); a })));
    strategies.push(("noisy params", Box::new(move |o, _, n| plan_ways(w, o, gr, n, planner, &Recipe { hidden: 0, anywhere: 0, tone: true, noise: 0.2, params: true, amplitude: 1.0 }))));
    strategies.push(("few ways", Box::new(move |o, _, n| plan_ways(w, o, gr, n, planner, &Recipe { hidden: 4, anywhere: 8, tone: true, noise: 0.1, params: true, amplitude: 1.0 }))));
    for (name, strategy) in &strategies {
        if what != "all" && !name.contains(what) { continue; }
        let mut views = coarse.clone();
        let rounds: Vec<usize> = std::env::var("ROUNDS").map_or(vec![10, 10, 20, 20], |r| r.split(',').map(|n| n.parse().unwrap()).collect());
        for n in rounds {
            let observed = world.observe(&views);
            let start = std::time::Instant::now();
            let more = strategy(&observed, &views, n);
            let took = start.elapsed();
            if std::env::var("SHOW").is_ok() { for m in &more { let (a, z) = rigel::geometry::azimuth_zenith(*m); print!(" {:.0}/{:.0}", a.to_degrees(), z.to_degrees()); } println!(); }
            views.extend(more);
            world.report(&format!("{name} ({took:.1?})"), &views, &models);
        }
    }
}
