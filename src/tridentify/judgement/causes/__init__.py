"""What else could explain a record: other causes, each fitted from where an estimate ended.

A residual that is not noise has many possible causes, and the same residual may look like an order
that is too low, a delay, or an input that was not held. So no cause is named because of how the
residual looks: every one is fitted, and its likelihood and its coefficients are compared.
"""
