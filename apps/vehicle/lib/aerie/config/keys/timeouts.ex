defmodule Aerie.Config.Keys.Timeouts do
  @moduledoc "When silence means something."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @doc "The section `timeouts`."
  @spec section() :: Field.t()
  def section do
    section(:timeouts, "When silence means something.", [
      field(:vehicle_stale_s, {:number, 0.1, 3600}, "A vehicle without a heartbeat for this long is stale.",
        default: 3.0
      ),
      field(:vehicle_lost_s, {:number, 0.1, 86_400}, "… and lost after this long.", default: 5.0),
      field(
        :vehicle_lost_high_latency_s,
        {:number, 1, 86_400},
        "A vehicle that is heard by high-latency links only is lost after this long.",
        default: 180.0
      ),
      field(:link_idle_s, {:number, 0.1, 86_400}, "A link that hears nothing for this long is idle.",
        default: 10.0
      )
    ])
  end
end
