"""What a user would fit a texel with instead of Rigel, on the texels of `rigel chart`, for its charts.

    python texels.py FOLDER [LOBES]

FOLDER: `cargo run --release -p rigel-tests --example texels -- FOLDER` fills it. LOBES: `lobes.cpp` of this folder, compiled; without it
Ceres is left out. Writes FOLDER/fit_peers.csv, which `rigel chart --peers FOLDER/fit_peers.csv` puts on its charts. One thread; needs
numpy and scipy. Coefficients count two bytes, as in Rigel's maps.
"""
import os

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")

import platform
import subprocess
import sys
import tempfile
import time

import numpy as np
import scipy
from scipy.interpolate import RBFInterpolator
from scipy.optimize import least_squares

folder = sys.argv[1]
load = lambda name: np.loadtxt(os.path.join(folder, name), delimiter=",", skiprows=1)
views, fresh = load("views.csv"), load("fresh.csv")
measured = load("measured.csv").reshape(-1, len(views), 4)
truth = load("truth.csv").reshape(len(measured), len(fresh), 3)
floor = float(load("floor.csv"))
radiance, sigma = measured[:, :, :3], measured[:, :, 3]
texels = len(radiance)
rows = []


def score(name, cpu_s, predicted, size):
    error = (np.abs(predicted - truth) / (truth + floor)).mean((1, 2))
    rows.append((name, 1e6 * cpu_s, 100 * error.mean(), 100 * np.percentile(error, 95), size))
    print("%-24s %10.1f us %8.2f %% %8.2f %% %7.1f bytes" % rows[-1])


def timed(work, least_s=0.3):
    start, calls = time.process_time(), 0
    while True:
        result = work()
        calls += 1
        if time.process_time() - start > least_s:
            return (time.process_time() - start) / calls / texels, result


def lobes(x, v):
    """Kd, then m, Ks, r of each lobe: radiance toward v."""
    value = np.repeat(x[None, :3], len(v), 0)
    for lobe in x[3:].reshape(-1, 7):
        value = value + np.maximum(v @ lobe[4:], 0)[:, None] ** lobe[0] * lobe[1:4]
    return value


if len(sys.argv) > 2:
    for count in (1, 2, 3):
        with tempfile.TemporaryDirectory() as scratch:
            given, found = os.path.join(scratch, "in"), os.path.join(scratch, "out")
            with open(given, "wb") as f:
                np.array([texels, len(views)], np.int32).tofile(f)
                for part in (views, radiance, sigma):
                    part.astype(np.float64).tofile(f)
            cpu_s = float(subprocess.run([sys.argv[2], given, found, str(count)], check=True, capture_output=True).stdout)
            x = np.fromfile(found).reshape(texels, -1)
        score("Ceres, %d lobe%s" % (count, "s" * (count > 1)), cpu_s, np.stack([lobes(y, fresh) for y in x]), 2 * (3 + 6 * count) + 2 * count)


def scipy_lobe(o, s):
    """One lobe as scipy's manual would have it: bounds, and derivatives by differences."""
    peak = views[np.argmax(o.sum(1))]
    start = np.concatenate([0.8 * o.mean(0), [20.0], [0.1] * 3, peak])
    low, high = [0] * 3 + [1] + [0] * 3 + [-1.01, -1.01, 0], [2 * o.max()] * 3 + [5000] + [2 * o.max()] * 3 + [1.01] * 3

    def unit(x):
        return np.concatenate([x[:7], x[7:] / max(np.linalg.norm(x[7:]), 1e-9)])

    miss = lambda x: ((lobes(unit(x), views) - o) / s[:, None]).ravel()
    return unit(least_squares(miss, np.clip(start, np.array(low) + 1e-9, high), bounds=(low, high)).x)


cpu_s, x = timed(lambda: [scipy_lobe(o, s) for o, s in zip(radiance, sigma)])
score("scipy, 1 lobe", cpu_s, np.stack([lobes(y, fresh) for y in x]), 20)


def least_squares_basis(name, basis, size):
    """One pseudo-inverse for all texels, as relight fits its bases."""
    a = basis(views)

    def fit():
        return np.linalg.pinv(a) @ radiance.transpose(1, 0, 2).reshape(len(views), -1)

    cpu_s, coefficients = timed(fit)
    predicted = (basis(fresh) @ coefficients).reshape(len(fresh), texels, 3).transpose(1, 0, 2)
    score(name, cpu_s, predicted, size)


def polynomial(v):
    """Malzbender, Gelb and Wolters, "Polynomial texture maps", SIGGRAPH 2001, equation 2."""
    x, y = v[:, 0], v[:, 1]
    return np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], 1)


def hemispherical(order):
    from math import factorial

    from scipy.special import lpmv

    def basis(v):
        """Gautron et al., "A novel hemispherical basis", EGSR 2004, equation 7."""
        z, azimuth = 2 * np.clip(v[:, 2], 0, 1) - 1, np.arctan2(v[:, 1], v[:, 0])
        columns = []
        for l in range(order):
            for m in range(-l, l + 1):
                k = np.sqrt((2 * l + 1) * factorial(l - abs(m)) / (2 * np.pi * factorial(l + abs(m))))
                p = k * lpmv(abs(m), l, z)
                columns.append(p if m == 0 else np.sqrt(2) * p * (np.cos(m * azimuth) if m > 0 else np.sin(-m * azimuth)))
        return np.stack(columns, 1)

    return basis


least_squares_basis("PTM, 6", polynomial, 36)
least_squares_basis("HSH, 9", hemispherical(3), 54)
least_squares_basis("HSH, 16", hemispherical(4), 96)
least_squares_basis("HSH, 36", hemispherical(6), 216)

nearest = np.argmax(fresh @ views.T, 1)
score("nearest view", 0.1e-6, radiance[:, nearest], 6 * len(views))
flat = radiance.transpose(1, 0, 2).reshape(len(views), -1)
start = time.process_time()
between = RBFInterpolator(views, flat, kernel="thin_plate_spline", neighbors=40)(fresh)
cpu_s = (time.process_time() - start) / texels
score("thin plates, scipy", cpu_s, between.reshape(len(fresh), texels, 3).transpose(1, 0, 2), 6 * len(views))

processor = next((line.split(": ")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), "unknown")
with open(os.path.join(folder, "fit_peers.csv"), "w") as f:
    f.write("# processor: %s\n# python: %s, numpy %s, scipy %s\n" % (processor, platform.python_version(), np.__version__, scipy.__version__))
    f.write("model,cpu_us_per_texel,mean_error_percent,p95_error_percent,bytes_per_texel\n")
    for name, cpu_us, mean, p95, size in rows:
        f.write("%s,%.1f,%.2f,%.2f,%.1f\n" % (name.replace(",", ""), cpu_us, mean, p95, size))
