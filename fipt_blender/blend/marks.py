"""Every custom property that the add-on stores in Blender's data, and the look-ups by them.

What belongs to a light, a camera or a mesh is stored with it, so that it moves with it into other scenes and
files. Imported while Blender starts: needs bpy alone.
"""

from __future__ import annotations

from collections.abc import Collection

import bpy

# --- cameras ---------------------------------------------------------------------------------------------
VIEW = "fipt_view"  # name of the view that the camera shows
SPLIT = "fipt_split"  # the view's split: "train", "held_back"
RESOLUTION = "fipt_resolution"  # width and height of the photograph, pixels
PIXEL_ASPECT = "fipt_pixel_aspect"
LOOKED_PAST = "fipt_looked_past"  # hidden while another view is looked through: view layers, whether selected
# On an image that is a smaller copy of a photograph: the file of that
LARGE_PHOTOGRAPH = "fipt_large_photograph"

COLLECTION = "fipt_collection"  # on a collection that we made: its first name

# --- objects and meshes of the room ------------------------------------------------------------------------
OBJECT_ID = "fipt_object_id"  # by which runs find the object again: the name of its first export
IMPORTED = "fipt_imported"  # on a mesh that we imported: its file and the matrix to the alignment's space
ORIGINAL_MESH = "fipt_original_mesh"
ORIGINAL_STATE = "fipt_original_state"  # modifiers and slots (JSON)
OBJECT_SLOT = "fipt_original_slot_{}"  # material of a slot that is linked to the object
ADDED = "fipt_added"  # on a mesh that the scan lacks: `FOUND`, `CLOSED` or `DRAWN`
FOUND, CLOSED, DRAWN = "found", "closed", "drawn"  # by the engine; what closes small holes; by the artist
RESULT_MESH = "fipt_own_mesh"  # the result mesh, while the original is shown
MADE = "fipt_inserted"  # on a result mesh: digest of its geometry and layers as we made it
LAID_OUT = "fipt_laid_out"  # on a result mesh: digest of the atlas of its UVs
SPLIT_OFF = (
    "fipt_split_off"  # on a result mesh: those of the object's exported triangles that became fixtures
)
REMOVED = (
    "fipt_removed"  # on what the artist has removed from the room, which is hidden: the removal's number
)
FILLED = "fipt_filled"  # on what completes the surfaces behind it: the removal's number
CATCHER = "fipt_catcher"  # we made the object a shadow catcher
PLATE = "fipt_plate"  # a copy, as photographed, for a scene over a photograph

# --- fixtures and lights -----------------------------------------------------------------------------------
FIXTURE = "fipt_fixture"  # the fixture's name in emitters.json
NAMED = "fipt_named"  # the name that we gave a fixture's object; any other is the artist's
PLACED = "fipt_placed"  # on a fixture: its place in the world as made, metres
CENTROID = "fipt_centroid"  # on a fixture: its centroid in emitters.json, by which it is known to be the same
FIXTURE_SOURCES = "fipt_sources"  # ids of the objects that the fixture was split off (JSON)
FIXTURE_LIGHT = "fipt_fixture_light"  # on a Blender light that stands for a fixture, its child
NEW_LIGHT = "fipt_light"  # on a light that the artist added
MISSING_LAMP = "fipt_missing_lamp"  # on a light that was inferred: its position in emitters.json
INFERRED = "fipt_inferred"  # on such a light that no photograph shows: its share of the light
BASE = "fipt_base"  # rgb as estimated or added: radiance of a fixture's front, watts of a light
UNIT = "fipt_unit"  # on lights, our world and the scene: W/(m² sr) for one of the unit of bases (photographs)
PROBABILITY = "fipt_probability"  # that a fixture emits, as estimated
BACK = "fipt_back"  # rgb radiance of a fixture's back; both are on the fixture's material, too
ON, SOLO, STOPS = "fipt_on", "fipt_solo", "fipt_stops"
TINT, COLOR, KELVIN = "fipt_tint", "fipt_color", "fipt_kelvin"
WRITTEN = "fipt_written"  # the strength that we wrote last; any other was set by the artist
VISIBILITY = "fipt_visibility"  # original ray visibility of a fixture that Blender lights stand for (JSON)
AS_CONVERTED = "fipt_as_converted"  # on these lights: shape and place as made; on the fixture: their number
PROBE = "fipt_probe"  # marks our light probe volume
BAKED = "fipt_baked"  # on it: it was baked since it was placed
STARTUP = "fipt_startup"  # marks objects of Blender's start-up file that we have hidden
MUTED = "fipt_muted"  # on the scene's other lights: whether they were hidden in viewports and renders

# --- worlds, scenes and view layers ------------------------------------------------------------------------
WORLD = "fipt_world"  # marks a world as ours; 1 where the run has an environment
WORLD_ON, WORLD_FACTOR = "fipt_on", "fipt_factor"
RESULT_WORLD = "fipt_own_world"  # on a scene: our world, while the original one is shown
ORIGINAL_WORLD = "fipt_original_world"  # on a scene
KEPT_FILM = "fipt_kept_film_transparent"  # on a scene
KEPT_RENDER = "fipt_kept_render"  # on a scene: settings that we made, what they were and what we made (JSON)
KEPT_SKY = "fipt_kept_sky"  # on a view layer: a solo light has switched off the artist's own world
UNPLACED = "fipt_unplaced"  # on a scene: settings of lamps that present results don't have (JSON)
LIGHT_GROUPS = "fipt_light_groups"  # on a view layer: names of the groups that we added (JSON)

# --- materials, node groups and images ---------------------------------------------------------------------
MATERIAL = "fipt_material"  # marks a material as ours; its value is the name of the atlas image
PART = "fipt_part"  # on our materials: key of the part, see `core.run.parts`
PART_NAME = "fipt_part_name"  # on our materials: the part's name, for parts whose key has changed
ESTIMATE = "fipt_estimate_{}"  # on a result mesh: the estimated material of each slot, which may hold another
REPLACEMENT = "fipt_replacement"  # on an estimated material: the one that the artist gave its part
ADJUSTMENT = "fipt_adjustment"  # marks the node group of the artist's adjustments
SURFACE = "fipt_surface"  # what fed the output before a map was shown: node and socket, a line each
TABLE = "fipt_table"  # on the node group that corrects Principled: digest of its table
TEXTURE = "fipt_texture"  # marks an image of applied results, or their environment
PICTURE = "fipt_picture"  # marks an image that we showed in an editor

# --- hints ------------------------------------------------------------------------------------------------
AREA = "fipt_area"  # on a hint's property group: centers of the area's triangles in the object's space

# --- names of nodes that more than one module uses ---------------------------------------------------------
OUTPUT = "FIPT Output"  # material output of our materials
PRINCIPLED = "FIPT Principled"
MAP = "FIPT {}"  # texture or attribute node of a map, and the colour attribute itself, by the map's label
FRONT, BACKSIDE = "FIPT Front", "FIPT Back"  # emission of a fixture's two sides
BACKGROUND = "FIPT Background"  # our world's background shader
MAPPING = "FIPT Mapping"  # our world's rotation


def remove_marks(owner: bpy.types.bpy_struct, *keys: str) -> None:
    """Delete custom properties; missing ones are skipped."""
    for key in keys:
        if key in owner:
            del owner[key]


def is_view(item: bpy.types.Object) -> bool:
    """Whether an object is the camera of a view."""
    return item.type == "CAMERA" and VIEW in item


def all_view_cameras(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's cameras that show a view; several may show the same one."""
    return [item for item in scene.objects if is_view(item)]


def view_cameras(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """The scene's cameras by the name of the view that they show; the first of several."""
    return {item[VIEW]: item for item in reversed(all_view_cameras(scene))}


def is_imported(item: bpy.types.Object) -> bool:
    """Whether an object is a mesh that we imported."""
    return IMPORTED in item


def is_exact(item: bpy.types.Object) -> bool:
    """Whether an object of the room is no scan, whatever the others are. What closes small holes is one."""
    return item.get(ADDED) in (FOUND, DRAWN)


def was_found(item: bpy.types.Object) -> bool:
    """Whether the engine has added an object to the room."""
    return item.get(ADDED) in (FOUND, CLOSED)


def has_results(item: bpy.types.Object) -> bool:
    """Whether an object has a result mesh, shown or not."""
    return ORIGINAL_MESH in item


def room_with_results(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's objects that have a result mesh."""
    return [item for item in scene.objects if has_results(item)]


def has_estimates(item: bpy.types.Object) -> bool:
    """Whether an object's mesh has estimated materials: a result mesh, or what completes the room."""
    return has_results(item) or FILLED in item


def filled_surfaces(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's objects that complete the surfaces behind what was removed."""
    return [item for item in scene.objects if FILLED in item]


def shadow_catchers(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's objects that we made shadow catchers."""
    return [item for item in scene.objects if CATCHER in item]


def object_id(item: bpy.types.Object) -> str:
    """The id by which runs find an object again; its name before it was first exported."""
    return str(item.get(OBJECT_ID, item.name))


def is_fixture(item: bpy.types.Object) -> bool:
    """Whether an object is an emitter of the photographed room."""
    return FIXTURE in item


def is_split_off(item: bpy.types.Object) -> bool:
    """Whether an object is a fixture split off the room's objects, or a Blender light that stands for one."""
    return FIXTURE_SOURCES in item


def is_linked(item: bpy.types.ID) -> bool:
    """Whether data belong to another file: their changes, also of overrides, are not saved with this one."""
    return item.library is not None or item.override_library is not None


def is_room_linked(scene: bpy.types.Scene) -> bool:
    """Whether results or lights of a scene belong to another file."""
    return any(is_linked(item) for item in _with_linked(scene) if has_results(item) or is_our_light(item))


def _with_linked(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The objects of a scene, also those in instances of collections, if any data belong to another file."""
    if not len(bpy.data.libraries):
        return []
    shown = [item.instance_collection for item in scene.objects if item.instance_collection is not None]
    return [*scene.objects, *(item for each in shown for item in each.all_objects)]


def is_our_light(item: bpy.types.Object) -> bool:
    """Whether an object is a fixture, a Blender light that stands for one, or a light that we added."""
    return FIXTURE in item or FIXTURE_LIGHT in item or NEW_LIGHT in item


def fixtures_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's fixtures by name."""
    return sorted((item for item in scene.objects if is_fixture(item)), key=lambda item: item.name)


def added_lights(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The lights that the artist added with our tools, by name."""
    added = (item for item in scene.objects if NEW_LIGHT in item and not is_fixture(item))
    return sorted(added, key=lambda item: item.name)


def lights_of(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's own fixtures by name, then the lights that were added."""
    return [item for item in (*fixtures_of(scene), *added_lights(scene)) if not is_linked(item)]


def linked_lamps(scene: bpy.types.Scene) -> dict[str, list[str]]:
    """Lamps of rooms of other files, by the paths of these; also those in instances of collections."""
    found: dict[str, list[str]] = {}
    for item in _with_linked(scene):
        if is_linked(item) and (is_fixture(item) or NEW_LIGHT in item):
            source = item.library or item.override_library.reference.library
            found.setdefault(source.filepath, []).append(item.name)
    return found


def other_lights(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's Blender lights that are not ours."""
    return [item for item in scene.objects if item.type == "LIGHT" and not is_our_light(item)]


def fixture_lights(item: bpy.types.Object) -> list[bpy.types.Object]:
    """The Blender lights that stand for a fixture."""
    return [child for child in item.children if FIXTURE_LIGHT in child]


def light_probe(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Our light probe volume of a scene."""
    return next((item for item in scene.objects if PROBE in item), None)


def estimated_objects(scene: bpy.types.Scene, room: Collection[str]) -> list[bpy.types.Object]:
    """The objects of the room, given by their names, its fixtures and their Blender lights."""
    return [item for item in scene.objects if item.name in room or is_fixture(item) or FIXTURE_LIGHT in item]


def result_world(scene: bpy.types.Scene) -> bpy.types.World | None:
    """Our world of a scene, shown or not."""
    for world in (scene.world, scene.get(RESULT_WORLD)):
        if world is not None and WORLD in world:
            return world
    return None


def has_light_groups(layer: bpy.types.ViewLayer) -> bool:
    """Whether a view layer has light groups that we added."""
    return LIGHT_GROUPS in layer
