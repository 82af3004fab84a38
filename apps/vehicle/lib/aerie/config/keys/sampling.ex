defmodule Aerie.Config.Keys.Sampling do
  @moduledoc "How often each group of a vehicle's state is published."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @groups [
    position: {:time, 1.0, %{}, 30.0},
    attitude: {:time, 1.0, %{}, 30.0},
    velocity: {:time, 1.0, %{}, 30.0},
    battery: {:threshold, 1.0, %{"remaining" => 0.01}, 30.0},
    gps: {:change, 0.5, %{}, 30.0},
    mode: {:change, 10.0, %{}, 30.0},
    health: {:change, 1.0, %{}, 30.0},
    home: {:change, 1.0, %{}, 60.0},
    mission: {:change, 1.0, %{}, 60.0},
    rc: {:time, 0.2, %{}, 60.0},
    link: {:aggregate, 0.2, %{}, 60.0}
  ]

  @doc "The names of the state groups."
  @spec groups() :: [atom()]
  def groups, do: Keyword.keys(@groups)

  @doc "The section `sampling`."
  @spec section() :: Field.t()
  def section do
    section(:sampling, "How often each group of a vehicle's state is published. Full rate stays inside.", [
      field(:position_hz, {:number, 0.001, 100}, "Short for groups.position.hz.", default: 1.0),
      field(:attitude_hz, {:number, 0.001, 100}, "Short for groups.attitude.hz.", default: 1.0),
      field(
        :battery_change_threshold,
        {:number, 0, 1},
        """
        Battery is published when its remaining charge (0 to 1) has changed by this; short for
        groups.battery.threshold.remaining.
        """,
        default: 0.01
      ),
      section(
        :groups,
        """
        Strategies: time (mean over each period), change (when a value differs), threshold (when a value named under
        threshold has moved by its amount), aggregate (min, max and mean over each period). hz is the rate, for change
        and threshold the highest one. After refresh_s seconds a value is published even if nothing moved; 0: never.
        """,
        Enum.map(@groups, &group/1)
      )
    ])
  end

  defp group({name, {strategy, hz, threshold, refresh}}) do
    section(name, "", [
      field(:strategy, {:enum, [:time, :change, :threshold, :aggregate]}, "", default: strategy),
      field(:hz, {:number, 0.001, 100}, "", default: hz),
      field(:threshold, {:map, {:number, 0, 1_000_000_000}}, "", default: threshold),
      field(:refresh_s, {:number, 0, 86_400}, "", default: refresh)
    ])
  end
end
