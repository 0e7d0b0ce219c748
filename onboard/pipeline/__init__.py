"""Events in, feature sets out: `handle(event) -> sets`. No socket, no thread, no clock.

Public:

- `error_budgets`: `Budget`, `BudgetWatch`, `NewestBudget`, `budget_text`
- `estimates`: `BORESIGHT`, `RELATIVE_VARIANCE`, `TIME_OFFSET`, `Contradiction`, `Estimate`, `SensorError`,
  `as_rows`, `larger_than_declared`, `not_adopted`, `in_words`
- `mount_search`: `MountSearch`
- `pipeline`: `Pipeline`
- `statistics`: `LeftOut`, `Summary`
"""
