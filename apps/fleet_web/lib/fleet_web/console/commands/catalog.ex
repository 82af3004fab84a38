defmodule FleetWeb.Console.Commands.Catalog do
  @moduledoc """
  All commands by their groups, as one user sees them for one vehicle: with the reason if the firmware lacks one, or the
  user may not give it. Pure.
  """

  alias Aerie.Vehicle.Command.{Type, Types}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Vehicle.Protocol

  @titles [
    flight: "Flight",
    navigation: "Navigation",
    mission: "Mission",
    payload: "Payload",
    manual: "Manual control and set-points",
    maintenance: "Maintenance",
    telemetry: "Telemetry",
    control: "In charge"
  ]
  # The page shows these elsewhere.
  @stream ~w(rc_override manual_control)

  @typedoc "`:gap`: why the firmware lacks it; `:denied`: why the user may not give it; both nil for a command that can be given."
  @type entry :: %{type: Type.t(), title: String.t(), gap: String.t() | nil, denied: String.t() | nil}

  @doc "The groups with their commands. `search`: words that all have to occur in name, group or meaning."
  @spec groups(vehicle :: map(), Roles.source(), search :: String.t()) :: [{String.t(), [entry()]}]
  def groups(vehicle, user, search \\ "") do
    words = search |> String.downcase() |> String.split()

    for {group, title} <- @titles,
        entries =
          for(
            type <- Types.all(),
            type.group == group,
            found?(type, title, words),
            do: entry(type, vehicle, user)
          ),
        entries != [],
        do: {title, entries}
  end

  @doc "One command by its name, or nil."
  @spec entry(String.t() | Type.t(), vehicle :: map(), Roles.source()) :: entry() | nil
  def entry(%Type{} = type, vehicle, user) do
    %{
      type: type,
      title: title(type.name),
      gap: Protocol.of(vehicle.autopilot).gap(type.name, vehicle.vehicle_type),
      denied: denied(type, user)
    }
  end

  def entry(name, vehicle, user) do
    with {:ok, type} <- Types.fetch(name), do: entry(type, vehicle, user), else: (:error -> nil)
  end

  @doc "The title of a command for people."
  @spec title(String.t()) :: String.t()
  def title("rtl"), do: "Return to launch"
  def title("goto"), do: "Go to"
  def title("jump"), do: "Jump to item"
  def title("prearm_check"), do: "Pre-arm check"
  def title("takeoff"), do: "Take off"
  def title("rc_override"), do: "RC override"
  def title("rx_pair"), do: "Bind receiver"
  def title("set_roi"), do: "Set region of interest"
  def title("clear_roi"), do: "Clear region of interest"
  def title("vtol_transition"), do: "VTOL transition"
  def title(name), do: name |> String.replace("_", " ") |> String.capitalize()

  defp denied(type, user) do
    unless Roles.allowed?(user, type.permission),
      do: "#{user.name} (#{user.role}) needs the permission #{type.permission}"
  end

  defp found?(%{name: name}, _title, []), do: name not in @stream

  defp found?(type, title, words) do
    text = String.downcase("#{type.name} #{title(type.name)} #{title} #{type.meaning}")
    Enum.all?(words, &String.contains?(text, &1))
  end
end
