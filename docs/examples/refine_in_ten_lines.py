"""Refine rough cameras, and print how sure the answer is."""

from photoreg import Finished, load_cameras, load_mesh, load_photo, refine

mesh = load_mesh("shell.ply")
photos = [load_photo("shell-left.jpg"), load_photo("shell-right.jpg")]
rough = load_cameras("rough.json").of_photos(photos)
for event in refine(mesh, photos, rough):  # Stop iterating to cancel.
    if isinstance(event, Finished):
        print(event.reason, event.verdict, f"{event.expected_error_px:.2f} px")
