"""A napari session without a window: open, estimate, segment, keep the layers."""

import numpy as np
from napari.components import ViewerModel
from npe2 import PluginManager

from napari_defocus import (
    confidence_map,
    estimate_candidates,
    label_blur_map,
    segment_in_focus,
)
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import (
    blur_map_layer,
    confidence_layer,
    in_focus_layer,
    not_trusted_layer,
)


def main():
    PluginManager.instance().discover()  # napari.Viewer does this by itself
    viewer = ViewerModel()
    _, picture = viewer.open_sample("napari-defocus", "ramp")
    picture.scale, picture.units = (0.65, 0.65), ("um", "um")

    plane = shown_plane(picture, viewer.dims)
    image = plane.read()
    candidates = estimate_candidates(image)
    blur_map = label_blur_map(candidates, image)
    confidence = confidence_map(candidates, blur_map)
    mask = segment_in_focus(candidates, image)

    variance = candidates.noise_variance
    sure = confidence_layer(plane, confidence, MapSettings(), variance)
    results = [
        blur_map_layer(plane, blur_map, MapSettings(), variance),
        sure,
        not_trusted_layer(sure, 0.5),
        in_focus_layer(plane, mask, MaskSettings(), MapSettings(), variance),
    ]
    for layer in add_results(viewer, results):
        print(f"{layer.name}: {layer.data.shape}, scale {layer.scale}, {layer.units}")
    print(f"noise variance {variance:.1e}")
    print(f"blur radius {np.percentile(blur_map, [5, 50, 95]).round(2)} px (5, 50, 95 %)")
    print(f"confidence 0.5 or more on {(confidence >= 0.5).mean():.0%} of the picture")
    print(f"in focus {mask.mean():.0%} of the picture")
    return viewer


if __name__ == "__main__":
    main()
