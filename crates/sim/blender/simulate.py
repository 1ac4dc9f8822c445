"""Simulates one dressed sequence with Blender's cloth: python simulate.py FOLDER

drape-generate starts this with a Python that has `bpy` and reads what it
writes. FOLDER holds, little-endian and without headers unless said otherwise:

  job.json              numbers: settings, counts, wind of each frame
  cloth_rest.f32        [vertex, 3], all garments as one mesh
  cloth_faces.u32       [face, 3]
  cloth_weights.f32     [3, vertex]: where between lowest and highest stiffness
                        (stretch, shear, bending) a vertex is
  pinned.u32            vertices that follow the body
  body_faces.u32        [face, 3]
  body.pc2, cloth.pc2   positions of each frame (point cache 2): the body, and
                        the cloth at rest but for pinned vertices

Frame 0 is the start, garments at rest; from frame 1 on the script writes
frame_NNNNN.f32 ([vertex, 3]) and then prints `drape-frame N`. Blender's own
frame numbers are one higher.
"""

import json
import os
import sys

import bpy
import numpy


def read(folder, name, kind, columns):
    return numpy.fromfile(os.path.join(folder, name), dtype=kind).reshape(-1, columns)


def mesh_object(name, positions, faces):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(positions.tolist(), [], faces.tolist())
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    return thing


def follow(thing, path):
    """Lets the object's vertices take the positions of a point cache."""
    cache = thing.modifiers.new("Positions", "MESH_CACHE")
    cache.cache_format = "PC2"
    cache.filepath = path
    cache.frame_start = 1.0
    cache.interpolation = "LINEAR"
    cache.forward_axis = "POS_Y"
    cache.up_axis = "POS_Z"


def positions_now(thing):
    mesh = thing.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    flat = numpy.empty(3 * len(mesh.vertices), dtype=numpy.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def group(thing, name, weights):
    made = thing.vertex_groups.new(name=name)
    for vertex, weight in enumerate(weights):
        made.add([vertex], float(weight), "REPLACE")
    return name


def dress(folder, job):
    rest = read(folder, "cloth_rest.f32", "<f4", 3)
    cloth = mesh_object("Cloth", rest, read(folder, "cloth_faces.u32", "<u4", 3))
    stretch, shear, bending = numpy.fromfile(
        os.path.join(folder, "cloth_weights.f32"), dtype="<f4"
    ).reshape(3, -1)
    pinned = numpy.fromfile(os.path.join(folder, "pinned.u32"), dtype="<u4")
    if len(pinned):
        follow(cloth, os.path.join(folder, "cloth.pc2"))
    modifier = cloth.modifiers.new("Cloth", "CLOTH")
    settings, contact = modifier.settings, modifier.collision_settings
    asked = job["settings"]
    settings.quality = asked["quality"]
    settings.mass = job["mass"]
    settings.air_damping = asked["air_damping"]
    settings.bending_model = "ANGULAR"
    for name in ("tension", "compression", "shear", "bending"):
        lowest, highest = job[name]
        setattr(settings, name + "_stiffness", lowest)
        setattr(settings, name + "_stiffness_max", highest)
        setattr(settings, name + "_damping", asked[name + "_damping"])
    settings.vertex_group_structural_stiffness = group(cloth, "stretch", stretch)
    settings.vertex_group_shear_stiffness = group(cloth, "shear", shear)
    settings.vertex_group_bending = group(cloth, "bending", bending)
    if len(pinned):
        made = cloth.vertex_groups.new(name="pinned")
        made.add(pinned.tolist(), 1.0, "REPLACE")
        settings.vertex_group_mass = "pinned"
    contact.use_collision = True
    contact.collision_quality = asked["collision_quality"]
    contact.friction = job["friction"]
    contact.use_self_collision = True
    contact.self_friction = job["friction"]
    modifier.point_cache.frame_start = 1
    modifier.point_cache.frame_end = job["frames"] + 1
    return cloth, contact


def obstacle(folder, job):
    faces = read(folder, "body_faces.u32", "<u4", 3)
    path = os.path.join(folder, "body.pc2")
    first = numpy.fromfile(path, dtype="<f4", offset=32, count=3 * job["body_vertices"])
    body = mesh_object("Body", first.reshape(-1, 3), faces)
    follow(body, path)
    body.modifiers.new("Collision", "COLLISION")
    body.collision.cloth_friction = job["body_friction"]
    return body


def warm_up(contact, body, job):
    """Large collision distances first, the asked ones from then on."""
    asked = job["settings"]
    for frame, times in ((1, asked["warm_up_times"]), (job["warm_up_frames"] + 1, 1.0)):
        # Blender's own limits: 1 unit to bodies, 0.1 units within the cloth.
        contact.distance_min = min(times * asked["distance"], 1.0)
        contact.self_distance_min = min(times * asked["self_distance"], 0.1)
        body.collision.thickness_outer = min(times * asked["body_thickness"], 1.0)
        contact.keyframe_insert("distance_min", frame=frame)
        contact.keyframe_insert("self_distance_min", frame=frame)
        body.keyframe_insert("collision.thickness_outer", frame=frame)


def blow(job):
    if not any(strength > 0.0 for *_, strength in job["wind"]):
        return
    bpy.ops.object.effector_add(type="WIND")
    wind = bpy.context.object
    wind.rotation_mode = "QUATERNION"
    field = wind.field
    field.flow = field.noise = field.falloff_power = field.wind_factor = 0.0
    before = None
    for frame, (*rotation, strength) in enumerate(job["wind"]):
        if (rotation, strength) == before:
            continue
        before = (rotation, strength)
        if strength > 0.0:
            wind.rotation_quaternion = rotation
            wind.keyframe_insert("rotation_quaternion", frame=frame + 1)
        field.strength = strength
        wind.keyframe_insert("field.strength", frame=frame + 1)


def main(folder):
    with open(os.path.join(folder, "job.json"), encoding="utf-8") as file:
        job = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    # Values hold from their frame on: nothing is interpolated.
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "CONSTANT"
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, job["frames"] + 1
    scene.render.fps = max(round(job["fps"]), 1)
    scene.render.fps_base = scene.render.fps / job["fps"]
    scene.use_gravity = True
    scene.gravity = job["gravity"]
    body = obstacle(folder, job)
    cloth, contact = dress(folder, job)
    warm_up(contact, body, job)
    blow(job)
    samples = numpy.memmap(os.path.join(folder, "body.pc2"), dtype="<f4", offset=32, mode="r")
    samples = samples.reshape(-1, job["body_vertices"], 3)
    for frame in range(job["frames"] + 1):
        scene.frame_set(frame + 1)
        off = float(numpy.abs(positions_now(body) - samples[frame]).max())
        if off > 1e-3:
            sys.exit(f"frame {frame}: the body is {off} units from where it should be")
        if frame == 0:
            continue
        name = os.path.join(folder, f"frame_{frame:05}.f32")
        positions_now(cloth).astype("<f4").tofile(name)
        print(f"drape-frame {frame}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
