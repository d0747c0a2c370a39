from .curves import (
    Curve as Curve,
    Times as Times,
    asymptotic_performance as asymptotic_performance,
    jumpstart as jumpstart,
    mean_return as mean_return,
    midpoint as midpoint,
    time_to_threshold as time_to_threshold,
)
from .hypothesis_tests import (
    probability_of_improvement as probability_of_improvement,
    sign_flip_test as sign_flip_test,
)
from .intervals import (
    Interval as Interval,
    interquartile_interval as interquartile_interval,
    mean_interval as mean_interval,
    paired_difference as paired_difference,
)
