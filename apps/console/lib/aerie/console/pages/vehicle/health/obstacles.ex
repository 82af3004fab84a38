defmodule Aerie.Console.Pages.Vehicle.Health.Obstacles do
  @moduledoc """
  What a vehicle's state says against a command that the policy allows: the policy does not know whether the vehicle can do it. Pure.
  """

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.{Firmware, Snapshot}
  alias Aerie.Console.Commands.Guided
  alias Aerie.Console.UI.Age
  alias Aerie.Console.Pages.Vehicle.View

  @in_flight ~w(goto orbit set_altitude set_yaw hold land rtl)
  @missions ~w(mission_start resume)
  @calming ~w(hold rtl land disarm force_disarm terminate)

  @doc "In words, the most important first; `[]` if nothing is known against it."
  @spec of(String.t(), View.t(), arming :: map()) :: [String.t()]
  def of(type, %View{vehicle: vehicle} = view, arming) do
    state = %{
      status: vehicle.status,
      armed: View.get(view, [:mode, :armed]),
      in_air: View.get(view, [:mode, :in_air]),
      flies?: Snapshot.flies?(vehicle)
    }

    reception(state, view) ++
      if(moves?(type), do: trouble(type, view), else: []) ++
      own(type, state, view, arming)
  end

  defp moves?(type), do: match?(%{moves_vehicle?: true}, Command.type(type))

  defp reception(%{status: :lost}, view),
    do: ["The vehicle is lost: not heard for #{Age.text(view.silent_us)}."]

  defp reception(%{status: :stale}, view), do: ["The vehicle was not heard for #{Age.text(view.silent_us)}."]
  defp reception(_online, _view), do: []

  defp trouble(type, _view) when type in @calming, do: []

  defp trouble(_type, view),
    do: for({:bad, text} <- View.warnings(view), do: "#{String.capitalize(text)}.")

  defp own("takeoff", state, _view, _arming),
    do: texts([state.in_air == true && "It is in the air.", disarmed(state)])

  defp own("arm", %{armed: true}, _view, _arming), do: ["It is armed."]

  defp own("arm", _state, %{vehicle: vehicle} = view, arming) do
    mode = View.get(view, [:mode, :mode])
    first = Firmware.arm_first(vehicle, mode)

    texts([first && "It cannot be armed in #{mode}.", arming.ready == false && "It is not ready to arm."]) ++
      Enum.map(arming.reasons, &"Not ready: #{&1}.")
  end

  defp own("disarm", %{in_air: true}, _view, _arming), do: ["It is in the air."]

  defp own(type, state, view, _arming) when type in @missions do
    texts([
      disarmed(state),
      (View.get(view, [:mission, :total]) == 0 or View.get(view, [:mission, :state]) == "NO_MISSION") &&
        "It has no mission."
    ])
  end

  defp own(type, state, _view, _arming) when type in @in_flight,
    do: texts([disarmed(state) || (state.flies? and state.in_air == false and "It is on the ground.")])

  defp own(_type, _state, _view, _arming), do: []

  defp disarmed(%{armed: false}), do: "It is not armed."
  defp disarmed(_state), do: nil

  defp texts(list), do: Enum.filter(list, & &1)

  @doc "The command that is being prepared on the page, of its assigns; nil if none."
  @spec prepared(map()) :: String.t() | nil
  def prepared(%{section: "commands", command: name}), do: name
  def prepared(%{target: %{type: type}}), do: hd(Guided.commands(type))
  def prepared(_assigns), do: nil
end
