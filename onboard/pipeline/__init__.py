"""Events in, feature sets out: `handle(event) -> sets`. No socket, no thread, no clock.

Public:

- `error_budgets`: `BudgetWatch`, `NewestBudget`, `budget_text`
- `estimates`: `BORESIGHT`, `RELATIVE_VARIANCE`, `TIME_OFFSET`, `as_rows`, `larger_than_declared`, `not_adopted`,
  `in_words`
- `mount_search`: `MountSearch`
- `pipeline`: `Pipeline`
- `summary`: `Budget`, `Contradiction`, `Estimate`, `LeftOut`, `SensorError`, `Summary`
"""
