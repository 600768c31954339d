"""Files that people bring and photoreg does not read: what each is, and what to do."""

from pathlib import Path

_AS_MESH = "save the surface as GLB, OBJ or PLY"
_AS_PHOTO = "save it as JPEG, PNG or TIFF"
_CLOUD = (
    "a point cloud, not a surface; make a mesh of it (in MeshLab, CloudCompare or "
    "Metashape) and save that as PLY"
)
_CAMERAS = "export its cameras as COLMAP, Bundler or nerfstudio"

_KINDS: dict[str, tuple[str, ...]] = {
    f"glTF as text; {_AS_MESH}: a .glb holds its buffers and pictures": (".gltf",),
    f"an FBX scene; open it in Blender and {_AS_MESH}": (".fbx",),
    f"a COLLADA scene; open it in Blender or MeshLab and {_AS_MESH}": (".dae",),
    f"a Blender file; {_AS_MESH} in Blender": (".blend",),
    f"a USD scene; export it as GLB or OBJ from the app that made it, or {_AS_MESH} in "
    "Blender": (".usd", ".usda", ".usdc", ".usdz"),
    f"a 3-D file of another program; {_AS_MESH} there": (
        ".3ds", ".max", ".ma", ".mb", ".c4d", ".skp", ".dxf", ".dwg", ".3dm", ".x3d",
        ".wrl", ".vrml", ".3mf", ".amf", ".x", ".lwo", ".ctm", ".vtk", ".vtp", ".abc",
        ".sproj", ".u3d", ".b3dm", ".osgb",
    ),
    f"CAD, not a mesh; mesh it in the program that made it and {_AS_MESH}": (
        ".step", ".stp", ".iges", ".igs", ".brep", ".ifc", ".sldprt",
    ),
    _CLOUD: (".las", ".laz", ".e57", ".xyz", ".pts", ".ptx", ".pcd", ".rcp", ".rcs", ".asc"),
    "a cloud of splats, not a surface; export a mesh": (".splat", ".spz", ".ksplat"),
    "a project of Metashape; export the model as PLY or OBJ, and the cameras as Agisoft "
    "XML": (".psx", ".psz"),
    "a project of RealityCapture; export the model as PLY or OBJ, and the registration "
    "as XMP or COLMAP": (".rcproj", ".rsproj"),
    f"cameras of another program; {_CAMERAS}": (".nvm", ".p4d", ".csv"),
    "a film; take single frames out of it, sharp ones, and save them as JPEG": (
        ".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".insv",
    ),
    f"a picture of a kind that is not read; {_AS_PHOTO}": (
        ".gif", ".bmp", ".psd", ".psb", ".exr", ".hdr", ".jp2", ".j2k", ".tga", ".dds",
        ".ktx2", ".pfm", ".ppm", ".pgm", ".svg", ".eps", ".pdf", ".ai", ".xcf", ".kra",
        ".mpo", ".jps", ".ico",
    ),
    "a RAW photo of a kind that is not read; convert it to DNG, or develop it and save "
    "it as JPEG or TIFF": (
        ".rw2", ".orf", ".x3f", ".pef", ".srw", ".3fr", ".iiq", ".erf", ".mrw", ".kdc",
        ".dcr", ".rwl", ".raw", ".gpr", ".crw", ".nrw", ".sr2", ".srf", ".mef", ".mos",
    ),
    "an archive of a kind that is not read; unpack it and give its files, or a zip": (
        ".rar", ".7z", ".tar", ".gz", ".tgz", ".bz2", ".xz", ".zst",
    ),
}  # fmt: skip
_BY_SUFFIX = {
    suffix: words for words, suffixes in _KINDS.items() for suffix in suffixes
}


def what_to_do(path: Path) -> str:
    """What a file of an unread kind is, and what to do, as the rest of a sentence.

    Returns:
        "it is a film; take ..."; empty where the kind is not known.
    """
    words = _BY_SUFFIX.get(path.suffix.lower(), "")
    return f"it is {words}" if words else ""
