"""Each oracle of the estimators rejects wrong formulas. Every check of oracles.py is here at least once."""

from tests.estimator import oracles
from tests.mutation import checks_of, mutation_tests

EI_QUAD = "check_expected_improvement_against_quadrature"
EI_DRAWS = "check_expected_improvement_against_monte_carlo"
PI_QUAD = "check_probability_of_improvement_against_quadrature"
LCB = "check_lower_confidence_bound_is_a_quantile"
LOG_NORMAL = "check_target_vector_improvement_is_that_of_the_matched_log_normal"
TAIL = "check_target_vector_improvement_far_in_the_tail"
HOPELESS = "check_target_vector_improvement_of_a_hopeless_incumbent"
SMALL = "check_target_vector_improvement_of_small_variances"
DENSITY = "check_posterior_density_against_gpy"
GRADIENT = "check_gradient_against_gpy"
DIFFERENCES = "check_gradient_against_differences"
PRIOR = "check_prior_against_gpy"
VARIANCES = "check_variances_are_gpys_optima"
PREDICTION = "check_prediction_against_gpy"
TEXTBOOK = "check_prediction_against_the_textbook"
JACOBIAN = "check_jacobian_against_gpy"
JACOBIAN_DIFFERENCES = "check_jacobian_against_differences"
LIKELIHOOD = "check_likelihood_against_gpy"
LIKELIHOOD_SLOPE = "check_likelihood_slope_against_differences"
MATERN = "check_matern_prediction_against_gpy"
MATERN_TEXTBOOK = "check_matern_prediction_against_the_textbook"
STD = "check_std_against_the_covariance_of_least_squares"
REFITS = "check_std_against_refits_of_noisy_data"
UNSEEN = "check_std_of_what_is_not_seen_is_the_whole_cube"
LEAST_MOVED = "check_least_moved_is_the_mean_given_the_parameters_held"
TO_ROUNDING = "check_least_moved_of_parameters_that_are_known_to_rounding"
DISTANCE = "check_distance_is_that_of_the_inverse_covariance"
WITH_PRIOR = "check_covariance_with_a_prior_is_that_of_the_normal_equations"
BY_HAND = "check_significant_directions_by_hand"
PROJECTOR = "check_significant_is_a_projector_that_loses_little"
SCORE = "check_score_is_the_evidence_of_a_linear_model"
MARGINS = "check_margins_are_very_strong_evidence"
DISTURBANCE = "check_disturbance_against_least_squares"
ARRIVING = "check_arriving_inputs_against_integration"
LIMITED = "check_limits_against_a_grid"
RATES = "check_inputs_of_limited_rates_against_small_steps"
MEANS = "check_means_over_steps_against_small_steps"
FADING = "check_fading_is_what_is_left_of_the_start"
DRIVES = "check_friction_in_drives_is_found_and_taken_out"
DRAG = "check_drag_on_one_derivative_is_found_and_taken_out"
NEAR_REST = "check_dry_friction_is_not_known_near_rest"
SPREAD = "check_spread_is_that_of_white_noise_about_a_slow_mean"
HUBER = "check_step_is_the_minimum_of_hubers_loss"
COLOURED = "check_coloured_noise_against_normal_distributions"
EFFECTIVE = "check_effective_scale_is_that_of_means_of_correlated_samples"

GP = "estimator.bayesian.gaussian_process"
ACQUISITION = "estimator.bayesian.acquisition"
IDENTIFIABILITY = "estimator.identifiability"
HYPOTHESES = "estimator.hypotheses"
FRICTION = "estimator.effects.friction"
LAG = "estimator.effects.lag"
LIMITS = "estimator.effects.input_limits"
SCALE = "estimator.diagnosis.residual_scale"
LEAP = "estimator.bayesian.leap"
EI = (EI_QUAD, EI_DRAWS)
BOTH = (PREDICTION, TEXTBOOK)
SLOPES = (JACOBIAN, JACOBIAN_DIFFERENCES)
ML = (LIKELIHOOD, LIKELIHOOD_SLOPE)
MATERNS = (MATERN, MATERN_TEXTBOOK)

MUTANTS = [
    # id, module, old, new, the checks that must reject it
    ("lag-by-one-euler-step", LAG, "(-np.expm1(-gaps / lag.time_constant))", "(gaps / lag.time_constant)", (ARRIVING,)),
    ("lag-of-the-input-before", LAG, "inputs[1:].T.tolist()", "inputs[:-1].T.tolist()", (ARRIVING, RATES)),
    ("mean-of-a-lag-sign", LAG, "inputs[1:] - lag.time_constant", "inputs[1:] + lag.time_constant", (MEANS,)),
    ("mean-of-a-rate-twice-as-far", LAG, "/ (2.0 * gaps *", "/ (gaps *", (MEANS,)),
    ("mean-of-a-rate-in-one-direction", LAG, "moves * np.abs(moves)", "moves * moves", (MEANS,)),
    ("limit-of-what-arrives-sign", LIMITS, "sent - off", "sent + off", (LIMITED,)),
    ("limit-of-the-samples-within-it", LIMITS, "sent > limit", "sent < limit", (LIMITED,)),
    ("lower-limit-sign", LIMITS, "-_limit(-sent, -v, w)", "_limit(-sent, -v, w)", (LIMITED,)),
    ("dead-time-of-one-sample-more", LAG, "inputs[: max(len(inputs) - lag.n_late, 0)]",
     "inputs[[0, *range(len(inputs) - lag.n_late - 1)]]", (ARRIVING,)),
    ("rate-by-the-sample", LAG, "[(gaps * rate).tolist()", "[(gaps * 0.0 + rate).tolist()", (RATES,)),
    ("rate-of-the-input-before", LAG, "max(u - v, -limit)", "max(u, -limit)", (RATES,)),
    ("fading-twice-as-fast", LAG, "np.exp(-(times - times[0]) /", "np.exp(-2.0 * (times - times[0]) /", (FADING,)),
    ("fading-one-sample-longer", LAG, "np.arange(len(times)) < self.n_late", "np.arange(len(times)) <= self.n_late",
     (FADING,)),
    ("friction-that-drives", FRICTION, "xdot[term.channels[0]] += force", "xdot[term.channels[0]] -= force", (DRAG,)),
    ("friction-added-to-the-input", FRICTION, "u[term.at_input] -= force", "u[term.at_input] += force", (DRIVES,)),
    ("quadratic-friction-without-direction", FRICTION, "return v * abs(v)", "return v * v", (DRIVES,)),
    ("dry-friction-without-direction", FRICTION, "copysign(1.0, v)", "1.0", (NEAR_REST,)),
    ("dry-friction-known-at-rest", FRICTION, "abs(v) < self.slow", "abs(v) < 0.0", (NEAR_REST,)),
    ("friction-by-the-input-itself", FRICTION, "_Column(against * slope,", "_Column(slope,",
     (DRIVES, NEAR_REST)),
    ("friction-that-may-push", FRICTION, "(may_fall | (along > 0.0))", "(may_fall | (along < 0.0))",
     (DRIVES, DRAG, NEAR_REST)),
    ("ei-density-sign", ACQUISITION, "ndtr(d) + sigma * np.exp", "ndtr(d) - sigma * np.exp", EI),
    ("ei-density-without-half", ACQUISITION, "np.exp(-0.5 * d * d)", "np.exp(-d * d)", EI),
    ("ei-density-norm", ACQUISITION, "np.sqrt(2.0 * np.pi)", "np.sqrt(np.pi)", EI),
    ("ei-of-the-larger", ACQUISITION, "d = (incumbent - mu) / sigma", "d = (mu - incumbent) / sigma", EI),
    ("ei-without-density", ACQUISITION, "sigma * np.exp(", "0.0 * np.exp(", EI),
    ("ei-variance-for-std", ACQUISITION, "np.sqrt(np.asarray(variance, dtype=float))\n    d",
     "np.asarray(variance, dtype=float)\n    d", EI),
    ("pi-variance-for-std", ACQUISITION, "/ np.sqrt(np.asarray(variance, dtype=float)))",
     "/ np.asarray(variance, dtype=float))", (PI_QUAD,)),
    ("pi-of-the-larger", ACQUISITION, "ndtr((incumbent - np.asarray(mean", "ndtr(-(incumbent - np.asarray(mean",
     (PI_QUAD,)),
    ("lcb-upper", ACQUISITION, "return kappa * np.sqrt", "return -kappa * np.sqrt", (LCB,)),
    ("lcb-variance-for-std", ACQUISITION, "kappa * np.sqrt(np.asarray(variance, dtype=float))",
     "kappa * np.asarray(variance, dtype=float)", (LCB,)),
    ("sum-mean-without-variance", ACQUISITION, "np.sum(mu * mu + v,", "np.sum(mu * mu,",
     (LOG_NORMAL, HOPELESS)),
    ("sum-variance-of-one-square", ACQUISITION, "np.sum(2.0 * v * v +", "np.sum(1.0 * v * v +", (LOG_NORMAL,)),
    ("sum-variance-cross-term", ACQUISITION, "4.0 * mu * mu * v", "2.0 * mu * mu * v", (LOG_NORMAL, SMALL, TAIL)),
    ("shape-of-the-mean", ACQUISITION, "V / M / M", "V / M", (LOG_NORMAL, SMALL, TAIL)),
    ("location-sign", ACQUISITION, "/ s + 0.5 * s", "/ s - 0.5 * s", (LOG_NORMAL,)),
    ("partial-mean-unshifted", ACQUISITION, "M * scipy.special.ndtr(likely - s)",
     "M * scipy.special.ndtr(likely)", (LOG_NORMAL, SMALL)),
    ("partial-mean-shifted-up", ACQUISITION, "M * scipy.special.ndtr(likely - s)",
     "M * scipy.special.ndtr(likely + s)", (LOG_NORMAL, SMALL)),
    ("tail-without-incumbent", ACQUISITION, "tail = np.log(incumbent) - 0.5", "tail = -0.5", (TAIL, LOG_NORMAL)),
    ("tail-without-half", ACQUISITION, "- 0.5 * unlikely * unlikely", "- unlikely * unlikely", (TAIL, LOG_NORMAL)),
    ("tail-of-one-mills-ratio", ACQUISITION, " - scipy.special.erfcx((s - unlikely) / SQRT2)", "",
     (TAIL, LOG_NORMAL, SMALL)),
    ("tail-shifted-down", ACQUISITION, "erfcx((s - unlikely)", "erfcx((-s - unlikely)", (TAIL, LOG_NORMAL, SMALL)),
    ("mills-twice", ACQUISITION, "np.log(0.5 * np.maximum(mills", "np.log(1.0 * np.maximum(mills",
     (TAIL, LOG_NORMAL, SMALL)),
    ("mills-without-root", ACQUISITION, "erfcx(-unlikely / SQRT2)", "erfcx(-unlikely)", (TAIL, LOG_NORMAL)),
    ("body-for-tail", ACQUISITION, "np.where(d > 0.0,", "np.where(d < 0.0,", (TAIL, LOG_NORMAL, SMALL)),
    ("noise-twice", GP, "NOISE: Final = 1e-8", "NOISE: Final = 2e-8", (DENSITY, GRADIENT, *BOTH)),
    ("concentrated-degrees", GP, "Y, alpha) / n,",
     "Y, alpha) / (n - 1),", (DENSITY, GRADIENT, DIFFERENCES)),
    ("determinant-once", GP, "k * np.log(L.diagonal()).sum()", "np.log(L.diagonal()).sum()",
     (DENSITY, DIFFERENCES)),
    ("determinant-half", GP, "k * np.log(L.diagonal()).sum()", "0.5 * k * np.log(L.diagonal()).sum()",
     (DENSITY, DIFFERENCES)),
    ("variances-without-half", GP, "0.5 * n * np.log(q).sum()", "n * np.log(q).sum()",
     (DENSITY, DIFFERENCES)),
    ("constant-without-exponent", GP, "(1.0 + _LOG_2PI)", "_LOG_2PI", (DENSITY,)),
    ("gradient-without-half", GP, "G = 0.5 * (2.0 * k", "G = 1.0 * (2.0 * k",
     (GRADIENT, DIFFERENCES)),
    ("gradient-of-one-output", GP, "2.0 * k * lower", "2.0 * lower", (GRADIENT, DIFFERENCES)),
    ("gradient-without-variances", GP, "(alpha / q) @ alpha.T", "alpha @ alpha.T", (GRADIENT, DIFFERENCES)),
    ("gradient-in-the-plain-lengthscale", GP, "G.reshape(-1) * inverse_squares",
     "G.reshape(-1) * inverse_squares**1.5", (GRADIENT, DIFFERENCES)),
    ("inverse-of-one-triangle", GP, "2.0 * k * lower -", "k * lower -",
     (GRADIENT, DIFFERENCES)),
    ("lengthscale-unsquared", GP, "np.exp(-2.0 * log_lengthscales)", "np.exp(-1.0 * log_lengthscales)",
     (DENSITY, GRADIENT)),
    ("prior-normal-in-the-logarithm", GP, "0.5 * z * z + log_lengthscales + np.log", "0.5 * z * z + np.log",
     (DENSITY, DIFFERENCES)),
    ("prior-norm", GP, "np.log(prior_std * np.sqrt(2.0 * np.pi))", "np.log(np.sqrt(2.0 * np.pi))",
     (DENSITY, PRIOR)),
    ("prior-without-half", GP, "(0.5 * z * z +", "(z * z +", (DENSITY, DIFFERENCES, PRIOR)),
    ("prior-slope-unscaled", GP, "gradient + z / prior_std + 1.0", "gradient + z + 1.0",
     (GRADIENT, DIFFERENCES, PRIOR)),
    ("prior-slope-without-one", GP, "z / prior_std + 1.0", "z / prior_std", (GRADIENT, DIFFERENCES)),
    ("correlation-without-half", GP, "np.exp(-0.5 * scipy.spatial.distance.cdist(",
     "np.exp(-scipy.spatial.distance.cdist(", (VARIANCES, *BOTH)),
    ("correlation-of-the-distance", GP, "\"sqeuclidean\"", "\"euclidean\"", (VARIANCES, *BOTH)),
    ("signal-of-n-minus-one", GP, "Y, self._alpha) / len(Z)",
     "Y, self._alpha) / (len(Z) - 1)", (VARIANCES, *BOTH)),
    ("variance-of-the-prior", GP, "1.0 - np.einsum", "1.0 - 0.0 * np.einsum", BOTH),
    ("variance-first-power", GP, "1.0 - np.einsum(\"ij,ij->j\", w, w)", "1.0 - np.sum(np.abs(w), axis=0)", BOTH),
    ("slope-sign", GP, "-(c * self._alpha.T)", "(c * self._alpha.T)", SLOPES),
    ("slope-in-lengthscales", GP, "(scaled / self._lengthscales)", "scaled", SLOPES),
    ("slope-of-another-kernel", GP, "c = np.exp(-0.5 *", "c = np.exp(-1.0 *", SLOPES),
    ("matern-of-another-order", GP, "(1.0 + s + s * s / 3.0) * np.exp(-s)", "(1.0 + s) * np.exp(-s)",
     MATERNS),
    ("matern-without-root", GP, "np.sqrt(5.0) * scipy.spatial", "5.0 * scipy.spatial", MATERNS),
    ("matern-noise-twice", GP, "lengthscales), noise + JITTER", "lengthscales), 2.0 * noise + JITTER",
     MATERNS),
    ("matern-variance-of-the-prior", GP, "self._variance - np.einsum", "self._variance - 0.0 * np.einsum",
     MATERNS),
    ("likelihood-without-half", GP, "value = 0.5 * (y @ alpha)", "value = (y @ alpha)", ML),
    ("likelihood-determinant", GP, "+ np.log(L.diagonal()).sum() + 0.5 * n * _LOG_2PI",
     "+ 0.5 * np.log(L.diagonal()).sum() + 0.5 * n * _LOG_2PI", ML),
    ("likelihood-constant", GP, "+ 0.5 * n * _LOG_2PI", "+ n * _LOG_2PI", (LIKELIHOOD,)),
    ("likelihood-jitter", GP, "* decay, noise + JITTER)", "* decay, noise)", (LIKELIHOOD,)),
    ("slope-in-the-signal", GP, "0.5 * (n - y @ alpha - (noise", "0.5 * (n + y @ alpha - (noise", ML),
    ("slope-in-the-noise", GP, "0.5 * noise * trace", "noise * trace", ML),
    ("slope-in-the-matern-lengthscales", GP, "5.0 / 6.0 * (squares", "5.0 / 3.0 * (squares", ML),
    ("slope-of-another-matern", GP, "* (1.0 + s) * decay", "* decay", ML),
    ("slope-of-one-triangle", GP, "(2.0 * lower - alpha[:, None]", "(lower - alpha[:, None]", ML),
    ("std-of-the-singular-values", IDENTIFIABILITY, "np.maximum(self.singular_values, 1e-12)[:, None])",
     "(1.0 / np.maximum(self.singular_values, 1e-12))[:, None])", (STD, REFITS)),
    ("std-is-a-variance", IDENTIFIABILITY, "np.minimum(np.sqrt(variance), 1.0)", "np.minimum(variance, 1.0)",
     (STD, REFITS, UNSEEN)),
    ("std-along-the-rows", IDENTIFIABILITY, "** 2, axis=0)", "** 2, axis=1)", (STD, REFITS)),
    ("std-beyond-the-bounds", IDENTIFIABILITY, "np.minimum(np.sqrt(variance), 1.0)", "np.sqrt(variance)", (UNSEEN,)),
    ("std-of-the-best-direction", IDENTIFIABILITY, "np.sum((self.directions", "np.min((self.directions",
     (STD, REFITS)),
    ("covariance-of-singular-values", IDENTIFIABILITY, "(self.singular_values**2 + spread**-2)",
     "(self.singular_values + spread**-2)", (WITH_PRIOR,)),
    ("held-from-the-most-moved", IDENTIFIABILITY, "np.argsort(np.abs(change)", "np.argsort(-np.abs(change)",
     (LEAST_MOVED,)),
    ("held-by-variances", IDENTIFIABILITY, "np.sqrt(self.covariance(1.0).diagonal())",
     "self.covariance(1.0).diagonal()", (LEAST_MOVED,)),
    ("held-as-long-as-all-cost-little", IDENTIFIABILITY, "if cost - before >", "if cost >", (LEAST_MOVED,)),
    ("held-beyond-the-square-root", IDENTIFIABILITY, "> n_std**2:", "> n_std:", (LEAST_MOVED,)),
    ("others-stay-where-parameters-are-held", IDENTIFIABILITY, "np.linalg.lstsq(rows[:, moved], rows @ change)[0]",
     "change[moved]", (LEAST_MOVED, TO_ROUNDING)),
    ("held-without-the-prior", IDENTIFIABILITY, "prior = np.eye(", "prior = 1e-3 * np.eye(",
     (LEAST_MOVED,)),
    ("distance-in-variances", IDENTIFIABILITY, "np.linalg.norm(self.singular_values *",
     "np.linalg.norm(self.singular_values**2 *", (DISTANCE,)),
    ("distance-unweighted", IDENTIFIABILITY, "np.linalg.norm(self.singular_values *", "np.linalg.norm(", (DISTANCE,)),
    ("distance-of-transposed-directions", IDENTIFIABILITY, "(self.directions @ change)))",
     "(change @ self.directions)))", (DISTANCE,)),
    ("covariance-of-the-prior's-deviation", IDENTIFIABILITY, "+ spread**-2)", "+ spread**-1)", (WITH_PRIOR,)),
    ("covariance-on-columns", IDENTIFIABILITY, "(self.directions.T * variances) @ self.directions",
     "(self.directions * variances) @ self.directions.T", (WITH_PRIOR,)),
    ("change-unweighted", IDENTIFIABILITY, "self.singular_values * np.abs(", "np.abs(", (BY_HAND, PROJECTOR)),
    ("change-of-one-sign", IDENTIFIABILITY, "np.abs(self.directions @ change)", "(self.directions @ change)",
     (PROJECTOR,)),
    ("held-for-moved", IDENTIFIABILITY, "> n_std]", "<= n_std]", (BY_HAND, PROJECTOR)),
    ("threshold-unused", IDENTIFIABILITY, "> n_std]", "> 0.0]", (BY_HAND, PROJECTOR)),
    ("projector-on-columns", IDENTIFIABILITY, "np.abs(self.directions @ change)",
     "np.abs(self.directions.T @ change)", (PROJECTOR,)),
    ("score-without-free-values", HYPOTHESES, "self.n_free * log(", "0.0 * log(", (SCORE,)),
    ("score-of-half-the-free-values", HYPOTHESES, "self.n_free * log(", "0.5 * self.n_free * log(", (SCORE,)),
    ("margin-half", HYPOTHESES, "MARGIN: Final = 10.0", "MARGIN: Final = 5.0", (MARGINS,)),
    ("margin-of-proof-sign", HYPOTHESES, "self._lead >= MARGIN", "self._lead >= -MARGIN", (MARGINS,)),
    ("margin-of-certainty", HYPOTHESES, "lead >= 2.0 * MARGIN", "lead >= MARGIN", (MARGINS,)),
    ("noise-is-no-rival", HYPOTHESES, "min(self._lead, self.noise.score - self.parameters.score)", "self._lead",
     (MARGINS,)),
    ("margin-of-possibility-sign", HYPOTHESES, "self._lead > -MARGIN", "self._lead > MARGIN", (MARGINS,)),
    ("lead-of-the-worst", HYPOTHESES, "min(others) - self", "max(others[:2]) - self", (MARGINS,)),
    ("disturbance-at-the-oldest", HYPOTHESES, "Disturbance(course[-1]", "Disturbance(course[0]",
     (DISTURBANCE,)),
    ("disturbance-without-parabola", HYPOTHESES, "_ORDER: Final = 2", "_ORDER: Final = 1", (DISTURBANCE,)),
    ("spread-without-root", SCALE, " / np.sqrt(2.0)", "", (SPREAD,)),
    ("spread-of-the-median", SCALE, "_MAD: Final = 1.4826", "_MAD: Final = 1.0", (SPREAD,)),
    ("spread-about-the-mean", SCALE, "np.abs(np.diff(rows, axis=0))", "np.abs(rows - rows.mean(axis=0))", (SPREAD,)),
    ("coloured-not-stationary", SCALE, " / shrink + rows[0] ** 2", " / shrink", (COLOURED,)),
    ("coloured-without-determinant", SCALE, " + (n - 1) * np.log(shrink)", "", (COLOURED,)),
    ("coloured-of-any-innovations", SCALE, "1.0 / shrink, TOO_SMALL**2", "1.0, TOO_SMALL**2", (COLOURED,)),
    ("correlation-inverted", SCALE, "(1.0 + self.correlations) / (1.0 - self.correlations)",
     "(1.0 - self.correlations) / (1.0 + self.correlations)", (EFFECTIVE,)),
    ("correlation-of-another-lag", SCALE, "rows[1:] * rows[:-1]", "rows[2:] * rows[:-2]", (EFFECTIVE,)),
    ("least-fourth-roots", LEAP, "** -0.5", "** -0.25", (HUBER,)),
    ("least-squares", LEAP, "** -0.5", "** 0.0", (HUBER,)),
    ("absolute-below-one", LEAP, "np.abs(r + slope @ step), 1.0)", "np.abs(r + slope @ step), 1e-3)", (HUBER,)),
]  # fmt: skip

TestMutants = mutation_tests(MUTANTS, checks_of(oracles))
