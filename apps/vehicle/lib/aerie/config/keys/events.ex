defmodule Aerie.Config.Keys.Events do
  @moduledoc "When a value is an event."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @doc "The section `events`."
  @spec section() :: Field.t()
  def section do
    section(:events, "When a value is an event.", [
      field(:battery_low, {:number, 0, 1}, "Remaining charge (0 to 1) below which battery.low is given.",
        default: 0.25
      ),
      field(:battery_critical, {:number, 0, 1}, "… and battery.critical.", default: 0.1)
    ])
  end
end
