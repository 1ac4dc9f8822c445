"""Writes a small data set in D-LAYERS' layout, and what should be read from it.

    python3 make.py FOLDER '{"protocol": 4, ...}'

The pickles are written by Python's own pickle; "writer" old writes them as
Python 2 or an older numpy did: byte strings, other module names. Everything is
computed here on its own: bodies by 4 x 4 matrices and matrix exponentials.
"""

import json
import os
import pickle
import sys
import types

import numpy as np

OPTIONS = {
    "protocol": 4,
    "writer": "python3",  # python3 (plain pickle), numpy1, python2
    "style": "top",  # top, simulate, mixed
    "motion": "dict",  # dict, array, joints, still
    "order": "C",
    "models": "plain",  # plain, chumpy, select, npz
    "grid": 3,
    "frames": 6,
    "seq_start": 4,
    "light": False,  # without what should be read
    "sequences": {"train": ["00396"], "val": ["00007"], "test": ["00100", "99999"]},
}
JOINTS = 24
SCALE = 10.0


class Old(pickle._Pickler):
    """Writes names (and with python2, strings) as older programs did."""

    dispatch = dict(pickle._Pickler.dispatch)

    def __init__(self, file, protocol, python2):
        super().__init__(file, protocol)
        self.python2 = python2

    def save_global(self, obj, name=None):
        name = name or getattr(obj, "__qualname__", obj.__name__)
        module = getattr(obj, "__module__", None) or pickle.whichmodule(obj, name)
        module = module.replace("numpy._core", "numpy.core").replace("sparse._csc", "sparse.csc")
        if self.python2:
            module = {"builtins": "__builtin__", "copyreg": "copy_reg"}.get(module, module)
        if self.proto >= 4:
            self.save(module)
            self.save(name)
            self.write(pickle.STACK_GLOBAL)
        else:
            self.write(pickle.GLOBAL + f"{module}\n{name}\n".encode())
        self.memoize(obj)

    dispatch[types.FunctionType] = save_global

    def save_text(self, obj):
        if not self.python2:
            return pickle._Pickler.dispatch[type(obj)](self, obj)
        data = obj.encode("latin1") if isinstance(obj, str) else obj
        if self.proto == 0:
            quoted = repr(data)[1:]
            self.write(b"S" + quoted.encode() + b"\n")
        elif len(data) < 256:
            self.write(b"U" + bytes([len(data)]) + data)
        else:
            self.write(b"T" + len(data).to_bytes(4, "little") + data)
        self.memoize(obj)

    dispatch[str] = save_text
    dispatch[bytes] = save_text


def write(options, path, value):
    with open(path, "wb") as file:
        if options["writer"] == "python3":
            pickle.dump(value, file, options["protocol"])
        else:
            Old(file, options["protocol"], options["writer"] == "python2").dump(value)


def foreign(module, name):
    """A class as another program's pickle names it."""
    return type(name, (), {"__module__": module})


def instance(cls, state):
    value = cls()
    value.__dict__.update(state)
    return value


def model(seed):
    """A body model of 14 vertices and SMPL's 24 joints."""
    rng = np.random.default_rng(seed)
    vertices = 14
    regressor = rng.random((JOINTS, vertices)) * (rng.random((JOINTS, vertices)) < 0.4)
    regressor[:, 0] += 0.1
    regressor /= regressor.sum(1, keepdims=True)
    weights = rng.random((vertices, JOINTS)) * (rng.random((vertices, JOINTS)) < 0.2)
    weights[:, 3] += 0.1
    weights /= weights.sum(1, keepdims=True)
    parents = np.array([0] + [int(rng.integers(0, j)) for j in range(1, JOINTS)])
    kintree = np.stack([parents, np.arange(JOINTS)]).astype(np.uint32)
    kintree[0, 0] = 2**32 - 1
    faces = np.array([[i, (i + 1) % vertices, (i + 5) % vertices] for i in range(vertices)])
    return {
        "v_template": rng.normal(size=(vertices, 3)),
        "shapedirs": rng.normal(size=(vertices, 3, 10)) * 0.05,
        "posedirs": rng.normal(size=(vertices, 3, 9 * (JOINTS - 1))) * 0.01,
        "J_regressor": regressor,
        "weights": weights,
        "kintree_table": kintree,
        "f": faces.astype(np.uint32),
    }


def exponential(vector):
    """Rotation matrix: the exponential of the cross product's matrix, by its series."""
    x, y, z = vector / 64.0
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    result, term = np.eye(3), np.eye(3)
    for n in range(1, 16):
        term = term @ k / n
        result = result + term
    for _ in range(6):
        result = result @ result
    return result


def pose_body(model, betas, pose, trans):
    """Posed vertices, rest vertices and root offset, in metres."""
    shaped = model["v_template"] + np.einsum("vks,s->vk", model["shapedirs"], betas)
    offset = (model["J_regressor"] @ shaped)[0]
    shaped = shaped - offset
    joints = model["J_regressor"] @ shaped
    turns = [exponential(v) for v in pose.reshape(JOINTS, 3)]
    feature = np.concatenate([(r - np.eye(3)).reshape(-1) for r in turns[1:]])
    posed = shaped + np.einsum("vkp,p->vk", model["posedirs"], feature)
    world = []
    for j in range(JOINTS):
        local = np.eye(4)
        local[:3, :3] = turns[j]
        parent = None if j == 0 else int(model["kintree_table"][0, j])
        local[:3, 3] = joints[j] - (0 if parent is None else joints[parent])
        world.append(local if parent is None else world[parent] @ local)
    back = [np.eye(4) for _ in joints]
    for inverse, joint in zip(back, joints):
        inverse[:3, 3] = -joint
    blend = np.einsum("vj,jab->vab", model["weights"], np.array([w @ b for w, b in zip(world, back)]))
    homogeneous = np.concatenate([posed, np.ones((len(posed), 1))], 1)
    return np.einsum("vab,vb->va", blend, homogeneous)[:, :3] + trans, shaped, offset


def write_models(options, root):
    folder = os.path.join(root, "smpl", "model")
    os.makedirs(folder)
    models = {"f": model(1), "m": model(2)}
    for letter, arrays in models.items():
        if options["models"] == "npz":
            np.savez_compressed(os.path.join(folder, f"model_{letter}.npz"), **arrays)
            continue
        entries = dict(arrays, bs_style="lbs", unused=None)
        writer = dict(options)
        if options["models"] != "plain":
            ch = foreign("chumpy.ch", "Ch")
            shape = instance(
                ch,
                {"x": arrays["shapedirs"], "_dirty_vars": {"x"}, "_itr": None, "_make_dense": False},
            )
            if options["models"] == "select":
                wide = np.concatenate([arrays["shapedirs"], arrays["shapedirs"] + 7.0], axis=2)
                picked = np.arange(wide.size).reshape(wide.shape)[:, :, :10]
                state = {
                    "a": instance(ch, {"x": wide}),
                    "idxs": picked.ravel(),
                    "preferred_shape": picked.shape,
                }
                shape = instance(foreign("chumpy.reordering", "Select"), state)
            entries["shapedirs"] = shape
            entries["J_regressor"] = sparse(arrays["J_regressor"])
            if writer["writer"] == "python3":
                # Plain pickle insists on importing what it names.
                writer["writer"] = "numpy1"
        write(writer, os.path.join(folder, f"model_{letter}.pkl"), entries)
    return models


def sparse(matrix):
    """A csc matrix: scipy's, or what scipy's has in its pickle."""
    try:
        from scipy.sparse import csc_matrix

        return csc_matrix(matrix)
    except ImportError:
        columns = [np.nonzero(column)[0] for column in matrix.T]
        state = {
            "_shape": matrix.shape,
            "data": np.concatenate([matrix[rows, c] for c, rows in enumerate(columns)]),
            "indices": np.concatenate(columns).astype(np.int32),
            "indptr": np.cumsum([0] + [len(rows) for rows in columns]).astype(np.int32),
        }
        return instance(foreign("scipy.sparse.csc", "csc_matrix"), state)


def grid_garment(size, rng):
    """Rest positions, faces and UV groups of a square of two panels, left and right."""
    u, v = np.meshgrid(np.linspace(0, 1, size), np.linspace(0, 1, size))
    rest = np.stack([4 * u, 6 * v, np.sin(3 * u)], -1).reshape(-1, 3) + rng.normal(size=(size * size, 3)) * 0.01
    faces, groups = [], {}
    middle = size // 2
    for name, columns in (("left", range(0, middle)), ("right", range(middle, size - 1))):
        own = []
        for row in range(size - 1):
            for column in columns:
                a = row * size + column
                own += [[a, a + 1, a + size], [a + 1, a + size + 1, a + size]]
        shift = 0.0 if name == "left" else 0.05
        uv = {i: 0.9 * np.array([u.flat[i], v.flat[i]]) + shift for i in {i for f in own for i in f}}
        # Groups may start a triangle at another corner.
        groups[name] = {"vertices": uv, "faces": [face[1:] + face[:1] for face in own]}
        faces += own
    return rest, np.array(faces), groups


def write_sequence(options, root, models, name, seed):
    rng = np.random.default_rng(seed)
    folder = os.path.join(root, "data", name)
    os.makedirs(folder)
    frames, start = options["frames"], options["seq_start"]
    kinds = ["jumpsuit_sleeveless", "jacket_hood"]
    expected = {"garments": [], "vertices": []}
    meta_garments = []
    for layer, kind in enumerate(kinds):
        rest, faces, groups = grid_garment(options["grid"], rng)
        vertices = rest + 0.3 * layer + rng.normal(size=(frames,) + rest.shape)
        dtype = [np.float32, np.float64][layer]
        stored = np.asarray(vertices, dtype=dtype, order=options["order"])
        write(
            options,
            os.path.join(folder, f"{kind}.pkl"),
            {"vertices": stored, "faces": faces.astype([np.int32, np.int64][layer]), "tpose": rest},
        )
        write(options, os.path.join(folder, f"uv_{kind}.pkl"), groups)
        cloth = {"tension_stiffness": 40 + layer, "bending_stiffness": 150.5, "mass": 0.25, "self_friction": 60}
        if layer == 1:
            cloth.update(compression_stiffness=30.0, shear_stiffness=20.0)
        meta_garments.append({"name": kind, "cloth": cloth})
        if options["light"]:
            continue
        expected["garments"].append(
            {
                "rest": rest.tolist(),
                "faces": faces.tolist(),
                "panel": [next(i for i, g in enumerate(groups.values()) if sorted(f) in map(sorted, g["faces"])) for f in faces.tolist()] if options["grid"] < 9 else [],
                "groups": {n: {str(i): list(uv) for i, uv in g["vertices"].items()} for n, g in groups.items()},
            }
        )
        expected["vertices"].append(stored.astype(np.float64).tolist())

    length = 1 if options["motion"] == "still" else start + frames + 2
    poses = rng.normal(size=(length, 3 * JOINTS)) * 0.5
    trans = rng.normal(size=(length, 3))
    motion = {"poses": poses, "trans": trans}
    if options["motion"] == "dict":
        motion = {key: {f: rows[f] for f in range(length)} for key, rows in motion.items()}
    if options["motion"] == "joints":
        motion["poses"] = poses.reshape(length, JOINTS, 3)
    motion_path = f"human/{name[:3]}/{name}_poses.pkl"
    os.makedirs(os.path.join(root, os.path.dirname(motion_path)), exist_ok=True)
    write(options, os.path.join(root, motion_path), motion)

    gender = "female" if seed % 2 else "male"
    betas = rng.normal(size=10)
    human = {
        "gender": gender,
        "motion_path": motion_path,
        "seq_start": start,
        "seq_end": start + frames,
        "frame_start": 60,
        "betas": betas.tolist(),
        "scale": SCALE,
        "collision": {"friction": 44.0},
    }
    quaternion = [0.5, -0.5, 0.5, 0.5]
    wind = [
        {
            "pivot_list": [
                {"frame_start": 62, "rotation_quaternion": [1.0, 0.0, 0.0, 0.0], "strength": 120},
                {"frame_start": 64, "rotation_quaternion": quaternion, "strength": [80.5]},
                {"frame_start": 64, "rotation_quaternion": quaternion, "strength": 300.25},
            ]
        }
    ]
    meta = {"human": human, "garment": meta_garments, "wind": wind}
    if options["style"] == "simulate":
        meta = {"simulate": meta}
    if options["style"] == "mixed":
        meta = {"human": human, "garment": meta_garments, "simulate": {"wind": wind, "human": human}}
    with open(os.path.join(folder, "meta.json"), "w") as file:
        json.dump(meta, file)

    if options["light"]:
        return {}
    body, roots, turns = [], [], []
    arrays = models["f" if gender == "female" else "m"]
    for f in range(frames):
        row = 0 if options["motion"] == "still" else start + f
        posed, rest_body, offset = pose_body(arrays, betas, poses[row], trans[row])
        body.append((SCALE * posed + SCALE * offset).tolist())
        roots.append((SCALE * trans[row]).tolist())
        turns.append(exponential(poses[row][:3]).tolist())
    expected.update(
        name=name,
        frames=frames,
        body=body,
        body_rest=(SCALE * rest_body).tolist(),
        body_faces=arrays["f"].tolist(),
        roots=roots,
        turns=turns,
        wind=[[0, 0, 0, 0, 0]] * 2 + [[1, 0, 0, 0, 120]] * 2 + [quaternion + [300.25]] * (frames - 4),
    )
    return expected


def main():
    root, options = sys.argv[1], dict(OPTIONS, **json.loads(sys.argv[2]))
    os.makedirs(root)
    models = write_models(options, root)
    listed = [name for names in options["sequences"].values() for name in names]
    present = [name for name in listed if name != "99999"]
    expected = {n: write_sequence(options, root, models, n, i) for i, n in enumerate(present)}
    with open(os.path.join(root, "data", "train_val_test.json"), "w") as file:
        json.dump(options["sequences"], file)
    with open(os.path.join(root, "expected.json"), "w") as file:
        json.dump(expected, file)


main()
