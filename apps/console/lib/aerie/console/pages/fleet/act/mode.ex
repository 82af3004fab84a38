defmodule Aerie.Console.Pages.Fleet.Act.Mode do
  @moduledoc """
  A mode for the selected vehicles by what it means, with each firmware's own word beside it. Only what all of them have
  is offered. Holding, returning and landing are commands with buttons of their own. Pure but for the component.
  """
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Fleet.Act.Press
  alias Aerie.Console.Pages.Fleet.Board.Row
  alias Aerie.Vehicle.{Firmware, Snapshot}

  @meanings [guided: "Guided", mission: "Mission"]
  # Modes that do nothing by themselves are for a pilot; these are for nobody.
  @not_offered ~w(INITIALISING INITIALIZING)

  @typedoc """
    * `:modes` - the mode of each vehicle; `:words` - the firmwares' own, if they differ from the name
    * `:refusal` - why this page cannot set it
  """
  @type choice :: %{
          name: String.t(),
          label: String.t(),
          words: String.t() | nil,
          refusal: String.t() | nil,
          modes: %{String.t() => String.t()}
        }

  @doc "What all of these vehicles have: the meanings, and the modes of a pilot by their names."
  @spec choices([Row.t()]) :: {[choice()], [choice()]}
  def choices(rows) do
    # The modes are the same for all of a kind.
    kinds = Map.new(rows, &{{&1.autopilot, &1.kind}, snapshot(&1)})

    meant =
      for {action, label} <- @meanings,
          words = Map.new(kinds, fn {kind, snapshot} -> {kind, Firmware.mode_for(snapshot, action)} end),
          Enum.all?(words, fn {_kind, mode} -> mode != nil end),
          do: %{choice(Atom.to_string(action), label, rows, words) | refusal: setpoints(words)}

    names =
      kinds
      |> Enum.map(fn {_kind, snapshot} -> Firmware.modes(snapshot) end)
      |> Enum.reduce(&(&1 -- (&1 -- &2)))

    manual =
      for name <- Enum.sort(names),
          Firmware.action(name) in [nil, :hold_height] and name not in @not_offered,
          do: choice(name, name, rows, Map.new(kinds, fn {kind, _snapshot} -> {kind, name} end))

    {meant, manual}
  end

  defp choice(name, label, rows, words) do
    own = for {{autopilot, _kind}, mode} <- words, mode != label, do: "#{Firmware.title(autopilot)}: #{mode}"

    %{
      name: name,
      label: label,
      words: if(own != [], do: own |> Enum.uniq() |> Enum.join(", ")),
      refusal: nil,
      modes: Map.new(rows, &{&1.id, words[{&1.autopilot, &1.kind}]})
    }
  end

  # A mode that flies set-points only is refused without them, and in the air it may end in a failsafe.
  defp setpoints(words) do
    Enum.find_value(words, fn {{autopilot, kind}, mode} ->
      command = %{type: "set_mode", params: %{mode: mode}}
      vehicle = %{autopilot: autopilot, kind: kind, mode_names: %{}, armed: true}

      if Firmware.of(autopilot).setpoints_first?(command, vehicle),
        do:
          "#{Firmware.title(autopilot)} flies #{mode} only while it gets set-points, and this page sends none"
    end)
  end

  defp snapshot(row),
    do: %Snapshot{id: row.id, autopilot: row.autopilot, vehicle_type: row.kind, system_id: row.system_id}

  @doc "The request of a press for these rows, or why there is none: each vehicle gets the mode that was shown of it."
  @spec request(event :: map(), [Row.t()]) :: {:ok, map()} | {:error, String.t()}
  def request(%{"mode" => name, "modes" => shown} = event, [_ | _] = rows) do
    {meant, manual} = choices(rows)
    choice = Enum.find(meant ++ manual, &(&1.name == name))

    cond do
      choice == nil or choice.modes != shown ->
        {:error, "not all of them have this mode any more"}

      choice.refusal ->
        {:error, choice.refusal}

      true ->
        modes = for %{id: id} <- rows, do: {id, %{"mode" => shown[id]}}
        Press.each(event["id"], "Mode #{choice.label}", "set_mode", modes)
    end
  end

  def request(_event, _rows), do: {:error, "the page has no such mode"}

  attr :value, :map, required: true, doc: "the ids of all that are selected"
  attr :rows, :list, required: true

  @doc "The choices."
  def mode(assigns) do
    {meant, manual} = choices(assigns.rows)
    assigns = assign(assigns, meant: meant, manual: manual)

    ~H"""
    <details class="charge" id="fleet-mode" phx-mounted={JS.ignore_attributes("open")}>
      <summary><.icon name="layers" /> <span>Mode …</span></summary>
      <div class="charge-forms fleet-modes">
        <p :if={@meant == []} class="muted">The selected vehicles have no mode in common that flies by itself.</p>
        <.choice :for={choice <- @meant} choice={choice} value={@value} />
        <details :if={@manual != []} id="fleet-mode-manual" phx-mounted={JS.ignore_attributes("open")}>
          <summary>More: needs a pilot with a transmitter</summary>
          <.choice :for={choice <- @manual} choice={choice} value={@value} />
        </details>
      </div>
    </details>
    """
  end

  attr :choice, :map, required: true
  attr :value, :map, required: true

  defp choice(assigns) do
    ~H"""
    <p>
      <.hold_button
        id={"fleet-mode-" <> String.replace(@choice.name, ~r/[^A-Za-z0-9_]/, "-")}
        event="mode"
        refusal={@choice.refusal}
        value={Map.merge(@value, %{mode: @choice.name, modes: @choice.modes})}
      >{@choice.label}</.hold_button>
      <span :if={@choice.words || @choice.refusal} class="muted">
        {@choice.words}{if @choice.refusal, do: ". #{@choice.refusal}."}
      </span>
    </p>
    """
  end
end
