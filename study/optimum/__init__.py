"""The paper's estimate of the optimum: many optimisations in the easiest setting, the best of all.

Level ground, undisturbed body: CMA-ES until convergence and the determinants-of-gait sampler for
100 trials, 50 runs of each (Antonova, Rai, Atkeson 2016, 'Details of Experimental Setup').
"""
