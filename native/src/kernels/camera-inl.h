// The camera in the level's type, made once for many Gaussians.
struct CameraParams {
  R axis[3][3];                     // rows of the view rotation
  R position[3], position_rest[3];  // together the camera centre
  R fx, fy;
  // x/z, y/z are clamped between these where the Jacobian is taken: the image borders, widened by a share of half the image (gsplat).
  R low_x, high_x, low_y, high_y;
  bool orthographic, antialiased;

  explicit CameraParams(const Frame& f) : fx(R(f.fx)), fy(R(f.fy)), orthographic(f.orthographic), antialiased(f.antialiased) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) axis[i][j] = static_cast<R>(f.viewmat[4 * i + j]);
      position[i] = static_cast<R>(f.position[i]), position_rest[i] = static_cast<R>(f.position[i] - static_cast<double>(position[i]));
    }
    const double margin_x = kFrustumMargin * f.width / (2 * f.fx), margin_y = kFrustumMargin * f.height / (2 * f.fy);
    low_x = R(-f.cx / f.fx - margin_x), high_x = R((f.width - f.cx) / f.fx + margin_x);
    low_y = R(-f.cy / f.fy - margin_y), high_y = R((f.height - f.cy) / f.fy + margin_y);
  }

  V view(int row, int column) const { return broadcast(axis[row][column]); }
  V along(int row, const V v[3]) const { return fma(view(row, 0), v[0], fma(view(row, 1), v[1], view(row, 2) * v[2])); }
  V inverse_depth(V z) const { return orthographic ? broadcast(1) : reciprocal(z); }
};
