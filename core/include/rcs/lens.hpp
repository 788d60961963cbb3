// How a camera's picture differs from one about its middle with square pixels and without distortion.
#pragma once

namespace rcs {

/// A calibrated camera: focal lengths, principal point, and where each pixel of a distorted picture looks.
///
/// The scene is drawn on a canvas without distortion. The picture is the canvas, or is looked up in it pixel by pixel.
struct Lens {
  double scale_x = 1;  ///< focal length along x over that of the model's field of view at the picture's height
  double scale_y = 1;  ///< the same along y
  double cx = 0;       ///< principal point on the canvas [pixels]; the centre of the top left pixel is (0, 0)
  double cy = 0;
  int width = 0;   ///< of the canvas [pixels]; without `lookup` that of the picture
  int height = 0;  ///< the same
  /// height × width × 2 of the picture: the column and row on the canvas that each pixel shows. Null: the same ones.
  const float* lookup = nullptr;
};

}  // namespace rcs
