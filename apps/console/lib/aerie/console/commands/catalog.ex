defmodule Aerie.Console.Commands.Catalog do
  @moduledoc """
  All commands by their groups, as one user sees them for one vehicle: with the reason if the firmware lacks one, or the
  user may not give it (`Aerie.Control.CommandExecutor.Offers`). Pure.
  """

  alias Aerie.Control.Commands
  alias Aerie.Control.Policy.Roles
  alias Aerie.Vehicle.Command

  @titles [
    flight: "Flight",
    navigation: "Navigation",
    mission: "Mission",
    payload: "Payload",
    manual: "Manual control and set-points",
    maintenance: "Maintenance",
    telemetry: "Telemetry",
    control: "Control"
  ]
  # The page shows these elsewhere.
  @stream ~w(rc_override manual_control)

  @typedoc "`:gap`: why the firmware lacks it; `:denied`: why the user may not give it; both nil for a command that can be given."
  @type entry :: %{type: map(), title: String.t(), gap: String.t() | nil, denied: String.t() | nil}

  @doc "The groups with their commands. `search`: words that all have to occur in name, group or meaning."
  @spec groups(vehicle :: map(), Roles.source(), search :: String.t()) :: [{String.t(), [entry()]}]
  def groups(vehicle, user, search \\ "") do
    words = search |> String.downcase() |> String.split()

    for {group, title} <- @titles,
        entries =
          for(
            type <- Command.types(),
            type.group == group,
            found?(type, title, words),
            do: entry(type, vehicle, user)
          ),
        entries != [],
        do: {title, entries}
  end

  @doc "One command by its name, or nil."
  @spec entry(String.t() | map(), vehicle :: map(), Roles.source()) :: entry() | nil
  def entry(%{name: _name} = type, vehicle, user) do
    {gap, denied} =
      case Commands.lacks(vehicle, type.name, user) do
        nil -> {nil, nil}
        {:firmware, reason} -> {reason, nil}
        {:permission, _permission, reason} -> {nil, reason}
      end

    %{type: type, title: title(type.name), gap: gap, denied: denied}
  end

  def entry(name, vehicle, user) do
    with %{} = type <- Command.type(name), do: entry(type, vehicle, user)
  end

  @doc """
  In words, which of these commands the user lacks a permission for on a vehicle that has them, each permission once.
  Titles beside names are those of the buttons.
  """
  @spec locked([{String.t(), title :: String.t()}], vehicle :: map(), Roles.source()) :: [String.t()]
  def locked(commands, vehicle, user) do
    lacking =
      for {name, title} <- commands,
          {:permission, permission, _reason} <- [Commands.lacks(vehicle, name, user)],
          do: {permission, title}

    for permission <- lacking |> Enum.map(&elem(&1, 0)) |> Enum.uniq() do
      titles = for {^permission, title} <- lacking, do: title
      verb = if length(titles) == 1, do: "needs", else: "need"

      "#{Enum.join(titles, ", ")} #{verb} the permission #{permission}. An admin gives it to a user in Settings."
    end
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

  defp found?(%{name: name}, _title, []), do: name not in @stream

  defp found?(type, title, words) do
    text = String.downcase("#{type.name} #{title(type.name)} #{title} #{type.meaning}")
    Enum.all?(words, &String.contains?(text, &1))
  end
end
