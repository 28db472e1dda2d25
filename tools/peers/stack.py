"""Rigel's radiance beside OpenCV's on the same stacks, in one run on one thread.

    python stack.py DATA.npz EXECUTABLE

DATA.npz: E (height x width x 3, true radiance) and for each stack NAME_ims (exposures x height x width x 3, 8 bits) and
NAME_t (exposure times). EXECUTABLE: `cargo build --release -p rigel-tests --example stack`. Needs numpy and OpenCV.
"""
import os
import subprocess
import sys
import tempfile
import time

import cv2
import numpy as np

cv2.setNumThreads(1)
data = np.load(sys.argv[1])
truth = data["E"]


def error(hdr, images):
    ok = ((images >= 20) & (images <= 235)).all(-1).any(0) & np.isfinite(hdr).all(-1)
    scale = [np.exp(np.median(np.log(np.maximum(hdr[ok][:, c], 1e-20) / truth[ok][:, c]))) for c in range(3)]
    a = np.abs(hdr / np.array(scale) / truth - 1)[ok]
    return 100 * np.median(a), 100 * np.percentile(a, 95)


def processor_s(f):
    f()
    runs = []
    for _ in range(5):
        start = time.process_time()
        f()
        runs.append(time.process_time() - start)
    return float(np.median(runs))


print("OpenCV", cv2.__version__)
for name in ("gamma_16", "gamma_5", "sigmoid_16", "sigmoid_5"):
    images, t = data[name + "_ims"], data[name + "_t"]
    stack = list(images)
    start = time.process_time()
    response = cv2.createCalibrateDebevec(300, 30.0, True).process(stack, t)
    response_s = time.process_time() - start
    merge = lambda: cv2.createMergeDebevec().process(stack, t, response)
    speed = images.shape[0] * images.shape[1] * images.shape[2] / processor_s(merge) / 1e6
    median, p95 = error(merge(), images)
    print(f"{name:>12} {median:8.3f} {p95:8.3f} {'':12} {response_s:10.2f} {speed:10.0f}", flush=True)

with tempfile.TemporaryDirectory() as folder:
    np.save(folder + "/E.npy", truth)
    for key in data.files:
        if key != "E":
            np.save(f"{folder}/{key}.npy", data[key])
    print("Rigel", flush=True)
    subprocess.run([sys.argv[2], folder], env={**os.environ, "RAYON_NUM_THREADS": "1"}, check=True)
