#include "principal_axes.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace svrgs {
namespace {

constexpr int kSweeps = 12;          // of Jacobi's method, which converges quadratically
constexpr double kFlattest = 1e-10;  // least ratio of two variances

// A rotation of rows and columns p and q of the symmetric a that makes a[p][q] zero, also of the columns of axes.
void rotate(double a[3][3], double axes[3][3], int p, int q) {
  if (a[p][q] == 0) return;
  const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]), t = std::copysign(1.0, theta) / (std::abs(theta) + std::sqrt(theta * theta + 1));
  const double c = 1 / std::sqrt(t * t + 1), s = t * c;
  for (int k = 0; k < 3; ++k) {
    const double x = a[k][p], y = a[k][q];
    a[k][p] = c * x - s * y, a[k][q] = s * x + c * y;
  }
  for (int k = 0; k < 3; ++k) {
    const double x = a[p][k], y = a[q][k];
    a[p][k] = c * x - s * y, a[q][k] = s * x + c * y;
  }
  for (int k = 0; k < 3; ++k) {
    const double x = axes[k][p], y = axes[k][q];
    axes[k][p] = c * x - s * y, axes[k][q] = s * x + c * y;
  }
}

// The quaternion of a rotation matrix, by its largest component.
void quaternion(const double m[3][3], float quat[4]) {
  const double trace = m[0][0] + m[1][1] + m[2][2];
  double q[4];
  if (trace > 0) {
    q[0] = 1 + trace, q[1] = m[2][1] - m[1][2], q[2] = m[0][2] - m[2][0], q[3] = m[1][0] - m[0][1];
  } else {
    const int i = m[0][0] >= m[1][1] && m[0][0] >= m[2][2] ? 0 : m[1][1] >= m[2][2] ? 1 : 2, j = (i + 1) % 3, k = (i + 2) % 3;
    q[0] = m[k][j] - m[j][k], q[1 + i] = 1 + m[i][i] - m[j][j] - m[k][k], q[1 + j] = m[j][i] + m[i][j], q[1 + k] = m[k][i] + m[i][k];
  }
  const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (int k = 0; k < 4; ++k) quat[k] = static_cast<float>(q[k] / length);
}

}  // namespace

void principal_axes(const double c[6], float log_scales[3], float quat[4]) {
  double a[3][3] = {{c[0], c[1], c[2]}, {c[1], c[3], c[4]}, {c[2], c[4], c[5]}}, axes[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  for (int sweep = 0; sweep < kSweeps && (a[0][1] != 0 || a[0][2] != 0 || a[1][2] != 0); ++sweep)
    rotate(a, axes, 0, 1), rotate(a, axes, 0, 2), rotate(a, axes, 1, 2);
  const double largest = std::max({a[0][0], a[1][1], a[2][2], std::numeric_limits<double>::min()});
  for (int k = 0; k < 3; ++k) log_scales[k] = static_cast<float>(0.5 * std::log(std::max(a[k][k], kFlattest * largest)));
  quaternion(axes, quat);
}

}  // namespace svrgs
