#!/usr/bin/env python3
"""Copies the reference numbers that the tests need: prune.py SRC DST [PREFIX].

SRC holds the safetensors made by running the published program, DST gets the
same files with fewer tensors (8 MiB in all, names and values unchanged):
 - weights, inputs and losses whole, without what is not read (incidence lists,
   the `official` variant, accuracies);
 - of gradients and of the weights after one Adam step every small tensor and
   one large one, so that each kind of weight is there;
 - of the unit cases the inputs once: the f32 file's are the f64 file's rounded
   (checked here), and the attention's weights are those of the whole block;
 - of the two preprocessed sequences the positions, rounded to f32, from which
   velocities, accelerations and statistics follow.
Only the standard library is used.
"""

import array
import json
import pathlib
import re
import struct
import sys

SIZES = {"F32": ("f", 4), "F64": ("d", 8), "U8": ("B", 1), "I32": ("i", 4), "I64": ("q", 8)}
SMALL = 1100  # bytes: vectors, head groups' weights, decoder's last bias


def read(path):
    """Tensors of a file: name -> (type, shape, bytes)."""
    blob = path.read_bytes()
    (length,) = struct.unpack("<Q", blob[:8])
    header = json.loads(blob[8 : 8 + length])
    header.pop("__metadata__", None)
    body = blob[8 + length :]
    return {
        name: (entry["dtype"], entry["shape"], body[slice(*entry["data_offsets"])])
        for name, entry in header.items()
    }


def write(path, tensors):
    header, body = {}, []
    at = 0
    # Wide types first, so that every tensor is aligned.
    for name, (kind, shape, data) in sorted(tensors.items(), key=lambda item: (-SIZES[item[1][0]][1], item[0])):
        header[name] = {"dtype": kind, "shape": shape, "data_offsets": [at, at + len(data)]}
        body.append(data)
        at += len(data)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(struct.pack("<Q", len(text)) + text + b"".join(body))


def rounded(tensor):
    kind, shape, data = tensor
    assert kind == "F64"
    return ("F32", shape, array.array("f", array.array("d", data)).tobytes())


def keep(tensors, pattern):
    return {name: tensor for name, tensor in tensors.items() if re.fullmatch(pattern, name)}


def spread(tensors, prefix, large):
    """Small tensors of a kind, and the named large ones."""
    return {
        name: tensor
        for name, tensor in tensors.items()
        if name.startswith(prefix) and (len(tensor[2]) <= SMALL or name[len(prefix) :] in large)
    }


def main(source, target, prefix="tiny"):
    source, target = pathlib.Path(source), pathlib.Path(target)
    load = lambda name: read(source / f"{name}.safetensors")
    out = {"weights": load("weights")}

    case = (
        r"(faces|h_faces|h_indices|indices|attr|attr_mask|g2p_mask|gravity|gt_vertices|h_state|human_radius"
        r"|invisable_force|invisable_rotation|mean_std|pmesh_mask|radius|state)"
    )
    out[f"{prefix}_inputs"] = keep(load(f"{prefix}_inputs"), case)
    out[f"{prefix}_forward_f32_tiesafe"] = keep(
        load(f"{prefix}_forward_f32_tiesafe"), r"pred|hook\.backbone\.encoder\.layers\.\d+\.call0\.out0"
    )
    train = load(f"{prefix}_train_f32_tiesafe")
    one = {"decode_head.proj.layers.2.weight", "backbone.encoder.layers.1.self_attn.attn.memory_weight.weight"}
    out[f"{prefix}_train_f32_tiesafe"] = (
        keep(train, r"loss\.decode\.loss_.*|loss\.total")
        | spread(train, "grad.", one)
        | spread(train, "grad_without_orth.", one)
        | spread(train, "adam1.", {"decode_head.proj.layers.2.weight"})
    )
    out[f"{prefix}_rollout_tiesafe"] = keep(
        load(f"{prefix}_rollout_tiesafe"), rf"static\.{case}|step\d+\.in\..*|step\d+\.pred"
    )
    out[f"{prefix}_multistep_train"] = keep(
        load(f"{prefix}_multistep_train"), rf"{case}|tiesafe\..*"
    )

    raw = load(f"{prefix}_preprocess")
    sequences = load(f"{prefix}_preprocess_stats_inputs")
    assert sequences["00001.h5.position"] == raw["h5.position"]
    out[f"{prefix}_preprocess"] = keep(
        raw, r"frame_index|h5\.wind|patch\..*|raw\.garment\d\.(faces|uvgroup.*)|raw\.human_faces|stat|stat_cov.*|trans_stat"
    ) | {name: rounded(tensor) for name, tensor in keep(sequences, r".*position").items()}

    attention, attention32 = load("unit_attention_f64"), load("unit_attention_f32")
    block, core, core32 = load("unit_encoder_layer_f32"), load("unit_attn_core_f64"), load("unit_attn_core_f32")
    for name, tensor in attention32.items():
        if name.startswith("w."):
            assert tensor == block[f"w.self_attn.attn.{name[2:]}"] == rounded(attention[name]), name
        elif name.startswith(("in.", "cot.")) and tensor[0] == "F32":
            assert tensor == rounded(attention[name]), name
    for name in ("query", "receiver", "sender", "body", "cot_self", "cot_body"):
        assert core32[name] == rounded(core[name]), name
    out["unit_attention_f64"] = (
        keep(attention, r"(in|cot)\..*|out\.(x|receiver|sender)|grad\.(x_.*|h_state)")
        | spread(attention, "gradw.", {"memory_weight.weight"})
    )
    out["unit_attention_f32"] = keep(
        attention32, r"out\.(x|h_sender)|grad\.(x_state|h_sender)|gradw\.sender_weight\.weight"
    )
    out["unit_encoder_layer_f32"] = (
        keep(block, r"(in|cot|w)\..*|out\.(x|receiver|sender|h_state)|grad\.(x_.*|h_state)")
        | spread(block, "gradw.", {"ffn.layers.0.0.weight"})
    )
    out["unit_attn_core_f64"] = keep(core, r"(?!grad_body).*")
    out["unit_attn_core_f32"] = keep(core32, r"out_.*|grad_.*")
    for name in ("unit_losses_f32", "unit_losses_f64", "unit_geometry"):
        out[name] = load(name)

    target.mkdir(parents=True, exist_ok=True)
    total = 0
    for name, tensors in out.items():
        assert tensors, name
        path = target / f"{name}.safetensors"
        write(path, tensors)
        total += path.stat().st_size
        print(f"{path.stat().st_size:9} {name}")
    print(f"{total:9} in all")
    assert total <= 8 * 2**20, "more than 8 MiB"


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    main(*sys.argv[1:])
