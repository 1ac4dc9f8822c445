"""Counts intersections in sequence files with PyPI's ipctk and compares them
with the counts that the files hold.

    python -m venv check && check/bin/pip install ipctk mcap protobuf numpy
    check/bin/python tests/ipctk_check.py FILE.mcap ...

A hit is an edge through a triangle: between garments, within a garment, or
between a garment and the body (`drape_geometry::intersect` counts the same).
Nothing of drape's own code is used: messages are read by the schema that each
file carries. Prints one line a file; leaves with 1 when any frame disagrees.
"""

import sys

import ipctk
import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader


def messages(path):
    """Header and frames of a file, decoded by the file's own schemas."""
    pools, found = {}, {}
    with open(path, "rb") as file:
        for schema, _, message in make_reader(file).iter_messages():
            if schema.id not in pools:
                pool = descriptor_pool.DescriptorPool()
                files = descriptor_pb2.FileDescriptorSet.FromString(schema.data)
                for one in files.file:
                    pool.Add(one)
                kind = pool.FindMessageTypeByName(schema.name)
                pools[schema.id] = message_factory.GetMessageClass(kind)
            decoded = pools[schema.id].FromString(message.data)
            found.setdefault(schema.name.rsplit(".")[-1], []).append(decoded)
    (header,) = found["SequenceHeader"]
    return header, sorted(found["Frame"], key=lambda frame: frame.index)


def numbers(data, kind):
    return np.frombuffer(data, dtype=kind).reshape(-1, 3)


def count(vertices, edges, faces, owner, body):
    """Hits between garments, within garments, with the body; `owner` of each vertex."""
    search = ipctk.LBVH()
    search.build(vertices, edges, faces)
    counts = [0, 0, 0]
    for pair in search.detect_edge_face_candidates():
        edge, face = edges[pair.edge_id], faces[pair.face_id]
        of_edge, of_face = owner[edge[0]], owner[face[0]]
        if of_edge == of_face == body or set(edge) & set(face):
            continue
        if ipctk.is_edge_intersecting_triangle(*vertices[edge], *vertices[face]):
            kind = 2 if body in (of_edge, of_face) else int(of_edge == of_face)
            counts[kind] += 1
    return counts


def check(path):
    """Frames of a file in which the counts differ; frames; hits found."""
    header, frames = messages(path)
    meshes = [numbers(garment.faces, "<u4") for garment in header.garments]
    meshes.append(numbers(header.body.faces, "<u4"))
    sizes = [len(garment.rest) // 12 for garment in header.garments]
    sizes.append(header.body.vertex_count)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    faces = np.concatenate([m.astype(np.int32) + s for m, s in zip(meshes, starts)])
    owner = np.repeat(np.arange(len(sizes)), sizes)
    edges = ipctk.edges(faces)
    wrong, hits = [], 0
    for number, frame in enumerate(frames):
        parts = [numbers(data, "<f4") for data in [*frame.garments, frame.body]]
        vertices = np.concatenate(parts).astype(np.float64)
        found = count(vertices, edges, faces, owner, len(sizes) - 1)
        stored = frame.intersections
        told = [stored.between_garments, stored.within_garments, stored.with_body]
        hits += sum(found)
        if found != told or not frame.HasField("intersections"):
            print(f"{path}: frame {number}: the file says {told}, ipctk {found}")
            wrong.append(number)
    return wrong, len(frames), hits


def main(paths):
    if not paths:
        sys.exit("expected sequence files")
    disagree = False
    for path in paths:
        wrong, frames, hits = check(path)
        disagree |= bool(wrong)
        print(f"{path}: {frames - len(wrong)} of {frames} frames agree, {hits} hits")
    sys.exit(int(disagree))


if __name__ == "__main__":
    main(sys.argv[1:])
