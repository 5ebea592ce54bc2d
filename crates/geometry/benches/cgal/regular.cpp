// CGAL's regular triangulation of samples written as text (n, then x y z r lines). Compiled and run by
//   cargo bench -p porograin-geometry --bench triangulation -- --cgal
// CGAL is GPL: a yardstick for development, never a dependency.
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Regular_triangulation_3.h>
#include <algorithm>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <vector>

typedef CGAL::Exact_predicates_inexact_constructions_kernel K;
typedef CGAL::Regular_triangulation_3<K> Regular;

static double processor_time() {
    timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int argc, char **argv) {
    std::printf("| sample | grains | pores | us per grain (shortest) | (median) |\n|---|---|---|---|---|\n");
    for (int a = 1; a < argc; a++) {
        std::ifstream in(argv[a]);
        size_t n = 0;
        in >> n;
        std::vector<Regular::Weighted_point> points;
        double x, y, z, r;
        while (in >> x >> y >> z >> r) points.emplace_back(Regular::Bare_point(x, y, z), r * r);
        int runs = std::clamp(int(400000 / n), 3, 15);
        std::vector<double> times;
        size_t pores = 0;
        for (int k = 0; k < runs; k++) {
            double start = processor_time();
            Regular t(points.begin(), points.end());
            times.push_back(processor_time() - start);
            pores = t.number_of_finite_cells();
        }
        std::sort(times.begin(), times.end());
        std::printf("| %s | %zu | %zu | %.2f | %.2f |\n", argv[a], n, pores, 1e6 * times[0] / n, 1e6 * times[runs / 2] / n);
    }
}
