"""The named ways to lay things over a photo: the same beside the scene and in it."""

from app.web.widgets import Option

THROUGH_STYLES = {
    "surface": Option("Surface", "The mesh, shaded, over the photo."),
    "wireframe": Option("Wires", "Every triangle of the mesh."),
    "lines": Option(
        "Lines", "Outline and creases of the mesh, to be laid on the photo's edges."
    ),
    "normals": Option(
        "Normals", "The mesh coloured by where it faces: relief, whatever the light."
    ),
    "photo": Option("Other photo", "The next photo, projected into this."),
}
PHOTO_STYLES = {
    "blend": Option("Blend", "Both mixed: double lines show a shift."),
    "checkerboard": Option(
        "Checks", "Squares of both in turn: broken lines show a shift."
    ),
    "difference": Option(
        "Difference", "Grey where both agree; orange and blue where one is brighter."
    ),
    "edges": Option("Edges", "Edges of the carried photo, in colour, over the other."),
    "blink": Option("Blink", "One after the other: what jumps is not aligned."),
    "swipe": Option("Swipe", "One photo left of the line, the other right of it."),
}
