"""A single photo in the page: what is said of it, and that it finds its camera."""

from playwright.sync_api import expect

from app.model.state import Document, PhotoEntry
from photoreg.registration.config import RegistrationConfig
from photoreg.synthetic.options import SceneOptions
from photoreg.synthetic.scene import make_scene
from tests.browser.refine_runs import start, to_its_end


def test_one_photo_is_refined_and_laid_over_the_surface(open_app):
    scene = make_scene(
        SceneOptions(kind="hard", width=160, height=120, error_px=(3.0, 4.0))
    )
    photo, rough, true = scene.photos[0], scene.rough_cameras[0], scene.cameras[0]
    entries, truth = (PhotoEntry(photo, rough),), ((photo.name, true),)
    app = open_app(Document(scene.mesh, scene.mesh.decimated(5_000), entries, truth))
    window = app.driver.page
    app.driver.dismiss_toasts()
    app.driver.tab("3 Refine")
    expect(
        window.get_by_text("One photo: it is compared with the shape")
    ).to_be_visible(timeout=120_000)
    start(app, RegistrationConfig.preset("fast"), hold=False)
    to_its_end(app)
    expect(window.get_by_text("The surface, by its normals, over")).to_be_visible()
    expect(window.get_by_role("button", name="Download report")).to_be_enabled(
        timeout=60_000
    )
    run = app.state.run
    assert run.grade != "unconvincing", run.verdict
    assert run.start_error_px is not None
    assert run.error_px is not None
    assert run.error_px < 0.5 * run.start_error_px, (run.error_px, run.start_error_px)
