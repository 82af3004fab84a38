defmodule Aerie.Console.Pages.Vehicle.Health.Calibration do
  @moduledoc "The sensors that a firmware calibrates, and the positions, from the table of commands."

  alias Aerie.Vehicle.Command
  alias Aerie.Console.Pages.Vehicle.Control.Actions

  @commands ~w(calibrate calibrate_position calibrate_accept calibrate_cancel)

  @doc "The sensors that the user can calibrate on the vehicle."
  @spec sensors(map()) :: [String.t()]
  def sensors(assigns),
    do:
      for(
        sensor <- values("calibrate", :sensor),
        Actions.able?("calibrate", assigns, %{sensor: sensor}),
        do: sensor
      )

  @doc "The positions."
  @spec positions() :: [String.t()]
  def positions, do: values("calibrate_position", :position)

  @titles %{
    "accelerometer_simple" => "Accelerometer (one position)",
    "rc" => "Radio",
    "esc" => "ESCs",
    "compass_motor" => "Compass/motor",
    "magnetometer" => "Compass"
  }

  @doc "A sensor or position for people."
  @spec title(String.t()) :: String.t()
  def title(name), do: @titles[name] || name |> String.replace("_", " ") |> String.capitalize()

  @doc "Whether a command belongs to calibration."
  @spec command?(String.t()) :: boolean()
  def command?(name), do: name in @commands

  defp values(type, name), do: Enum.find(Command.type(type).params, &(&1.name == name)).values
end
