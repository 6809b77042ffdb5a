"""How good a policy is: rollouts under the evaluation conditions, and the figures drawn from them."""
