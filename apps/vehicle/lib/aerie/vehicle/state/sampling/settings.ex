defmodule Aerie.Vehicle.State.Sampling.Settings do
  @moduledoc "How often each group of a vehicle's state is published."
  use Aerie.Base.Settings

  alias Aerie.Vehicle.State.Groups

  section "sampling", "How often each group of a vehicle's state is published. Full rate stays inside."

  setting :position_hz, {:number, 0.001, 100}, "Short for groups.position.hz.", example: "1"
  setting :attitude_hz, {:number, 0.001, 100}, "Short for groups.attitude.hz.", example: "1"

  setting :battery_change_threshold,
          {:number, 0, 1},
          """
          Battery is published when its remaining charge (0 to 1) has changed by this; short for
          groups.battery.threshold.remaining.
          """,
          example: "0.01"

  setting :groups,
          {:section, Enum.map(Groups.all(), &group/1)},
          """
          Strategies: time (mean over each period), change (when a value differs), threshold (when a value named under
          threshold has moved by its amount), aggregate (min, max and mean over each period). hz is the rate, for change
          and threshold the highest one. After refresh_s seconds a value is published even if nothing moved; 0: never.
          """

  defp group(%{name: name, sampling: {strategy, hz, threshold, refresh}}) do
    fields = [
      field(:strategy, {:enum, [:time, :change, :threshold, :aggregate]}, "", default: strategy),
      field(:hz, {:number, 0.001, 100}, "", default: hz),
      field(:threshold, {:map, {:number, 0, 1_000_000_000}}, "", default: threshold),
      field(:refresh_s, {:number, 0, 86_400}, "", default: refresh)
    ]

    section(name, "", fields)
  end

  @doc "Settings of groups, of which those that are left out, and all keys that are, have their defaults."
  @spec groups(map()) :: %{atom() => map()}
  def groups(given), do: from(%{sampling: %{groups: given}}).groups
end
