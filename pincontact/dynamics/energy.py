"""The rule by which impacts create no energy, for both methods.

Newton's restitution demands a rebound -e w_n at every contact that closes; where contacts, or a contact's normal and
tangent, are coupled, that and Coulomb's law together may do positive work (Kane's paradox). The work of impulses P that
take the relative velocity from w- to w+ is P . (w- + w+) / 2, summed over all contacts of the impact. Where that is
positive, all coefficients are multiplied by the largest common factor for which it is not; without restitution it never
is. The factor is found by bisection.
"""

# Work above this fraction of the sizes of its terms counts as positive; accuracy of the factor.
ENERGY_SLACK = 1e-9
KEPT_ACCURACY = 1e-3
