"""Plots the path of one vertex of a sequence file.

    python3 plot_vertex.py FILE.mcap PICTURE.png [GARMENT [VERTEX]]

Needs PyPI's mcap, numpy and matplotlib. A file carries its own schema; a program that
wants everything gives it to PyPI's protobuf. The one field that is needed here is
quick to find by hand.
"""

import sys

import numpy as np
from mcap.reader import make_reader

GARMENTS = 4  # number of Frame.garments: bytes f32 [v, 3], one of each garment


def fields(message):
    """Numbers and contents of the length-delimited fields of a protobuf message."""
    at = 0

    def varint():
        nonlocal at
        value, shift = 0, 0
        while True:
            byte = message[at]
            at += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    while at < len(message):
        key = varint()
        kind = key & 7
        if kind == 0:
            varint()
        elif kind == 2:
            size = varint()
            yield key >> 3, message[at : at + size]
            at += size
        else:
            at += {1: 8, 5: 4}[kind]


def chosen(what, items, number):
    """An item by a number that a person gave; numbers from the end are not meant."""
    if not 0 <= number < len(items):
        sys.exit(f"{what} {number}: expected 0 to {len(items) - 1}")
    return items[number]


def path_of(file, garment, vertex):
    """Positions of a vertex, [frame, 3]."""
    positions = []
    with open(file, "rb") as stream:
        # Most readers compare checksums only when asked.
        reader = make_reader(stream, validate_crcs=True)
        for _, _, message in reader.iter_messages(topics=["/drape/frame"]):
            garments = [content for number, content in fields(message.data) if number == GARMENTS]
            rows = np.frombuffer(chosen("garment", garments, garment), "<f4").reshape(-1, 3)
            positions.append(chosen("vertex", rows, vertex))
    if not positions:
        sys.exit(f"{file}: no messages on /drape/frame (a quantised file has other ones)")
    return np.array(positions)


def main():
    file, picture, *rest = sys.argv[1:]
    garment, vertex = ([int(word) for word in rest] + [0, 0][len(rest) :])[:2]
    path = path_of(file, garment, vertex)
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    for axis, name in enumerate("xyz"):
        pyplot.plot(path[:, axis], label=name)
    pyplot.xlabel("frame")
    pyplot.ylabel("position (units)")
    pyplot.title(f"vertex {vertex} of garment {garment}")
    pyplot.legend()
    pyplot.savefig(picture)
    for x, y, z in path:
        print(repr(float(x)), repr(float(y)), repr(float(z)))


if __name__ == "__main__":
    main()
