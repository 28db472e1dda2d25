"""Observations that Rigel has exported, read with nothing but Python's standard library.

    python3 observations.py zarr|exr PATH

writes a line of JSON (rows, columns, names of the views), then for each row, column and view R G B sigma as 32-bit floats.
"""

import json
import struct
import sys
import zlib


def zarr(path):
    """Arrays in chunks of zlib: https://zarr-specs.readthedocs.io/en/latest/v2/v2.0.html"""

    def load(name):
        with open(f"{path}/{name}") as file:
            return json.load(file)

    def array(name):
        meta = load(f"{name}/.zarray")
        assert meta["zarr_format"] == 2 and meta["order"] == "C" and meta["compressor"]["id"] == "zlib" and meta["filters"] is None
        assert len(load(f"{name}/.zattrs")["_ARRAY_DIMENSIONS"]) == len(meta["shape"])
        (rows, columns, *rest), (high, wide, *whole) = meta["shape"], meta["chunks"]
        assert rest == whole and meta["dtype"] == "<f4"
        each = 1
        for count in rest:
            each *= count
        values = {}
        for top in range(0, rows, high):
            for left in range(0, columns, wide):
                key = ".".join(map(str, [top // high, left // wide] + [0] * len(rest)))
                with open(f"{path}/{name}/{key}", "rb") as file:
                    numbers = struct.unpack(f"<{high * wide * each}f", zlib.decompress(file.read()))
                for y in range(min(high, rows - top)):
                    for x in range(min(wide, columns - left)):
                        start = (y * wide + x) * each
                        values[top + y, left + x] = numbers[start : start + each]
        return rows, columns, values

    assert load(".zgroup") == {"zarr_format": 2}
    names = load(".zattrs")["views"]
    rows, columns, radiance = array("radiance")
    _, _, sigma = array("sigma")

    def at(row, column, view):
        return (*radiance[row, column][3 * view : 3 * view + 3], sigma[row, column][view])

    return rows, columns, names, at


def exr(path):
    """One part of scan lines, ZIPS: https://openexr.com/en/latest/OpenEXRFileLayout.html"""
    with open(path, "rb") as file:
        data = file.read()
    assert data[:4] == b"\x76\x2f\x31\x01" and data[4] == 2
    place = 8

    def text():
        nonlocal place
        end = data.index(b"\0", place)
        found = data[place:end].decode()
        place = end + 1
        return found

    attributes = {}
    while data[place]:
        name, _ = text(), text()
        (size,) = struct.unpack_from("<i", data, place)
        attributes[name] = data[place + 4 : place + 4 + size]
        place += 4 + size
    place += 1
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    columns, rows = right - left + 1, bottom - top + 1
    assert attributes["compression"][0] == 2
    channels, at = [], 0
    described = attributes["channels"]
    while described[at]:
        end = described.index(b"\0", at)
        channels.append(described[at:end].decode())
        assert struct.unpack_from("<i", described, end + 1) == (2,)  # 32-bit floats
        at = end + 17
    offsets = struct.unpack_from(f"<{rows}Q", data, place)
    names = [view["name"] for view in json.loads(attributes["rigelObservations"])["views"]]
    length, lines = 4 * columns * len(channels), []
    for offset in offsets:
        row, size = struct.unpack_from("<ii", data, offset)
        packed = data[offset + 8 : offset + 8 + size]
        assert row == len(lines)
        if size < length:
            steps = zlib.decompress(packed)
            plain = bytearray(steps[:1])
            for step in steps[1:]:
                plain.append((plain[-1] + step - 128) & 255)
            packed = bytearray(length)
            packed[0::2], packed[1::2] = plain[: (length + 1) // 2], plain[(length + 1) // 2 :]
        values = struct.unpack(f"<{columns * len(channels)}f", packed)
        lines.append({name: values[i * columns : (i + 1) * columns] for i, name in enumerate(channels)})
    # Beside the layers the mean over the views.
    for line in lines:
        for column in range(columns):
            for channel in "RGB":
                seen = [line[f"{name}.{channel}"][column] for name in names]
                seen = [value for value in seen if value == value]
                mean = line[channel][column]
                assert (not seen and mean != mean) or abs(mean - sum(seen) / len(seen)) <= 1e-4 * abs(mean)

    def at(row, column, view):
        return tuple(lines[row][f"{names[view]}.{part}"][column] for part in ["R", "G", "B", "sigma"])

    return rows, columns, names, at


rows, columns, names, at = {"zarr": zarr, "exr": exr}[sys.argv[1]](sys.argv[2])
out = sys.stdout.buffer
out.write(json.dumps([rows, columns, names]).encode() + b"\n")
for row in range(rows):
    for column in range(columns):
        for view in range(len(names)):
            out.write(struct.pack("<4f", *at(row, column, view)))
