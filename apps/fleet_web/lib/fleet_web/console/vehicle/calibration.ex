defmodule FleetWeb.Console.Vehicle.Calibration do
  @moduledoc "The sensors that can be calibrated and the positions, from the table of commands."

  alias Aerie.Vehicle.Command.Types

  @commands ~w(calibrate calibrate_position calibrate_accept calibrate_cancel)

  @doc "The sensors."
  @spec sensors() :: [String.t()]
  def sensors, do: values("calibrate", :sensor)

  @doc "The positions."
  @spec positions() :: [String.t()]
  def positions, do: values("calibrate_position", :position)

  @doc "Whether a command belongs to calibration."
  @spec command?(String.t()) :: boolean()
  def command?(name), do: name in @commands

  defp values(type, name), do: Enum.find(Types.fetch!(type).params, &(&1.name == name)).values
end
