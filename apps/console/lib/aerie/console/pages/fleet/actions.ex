defmodule Aerie.Console.Pages.Fleet.Actions do
  @moduledoc "The actions for the selected vehicles. Their events say for which vehicles the operator saw them."
  use Aerie.Console, :component

  import Aerie.Console.Pages.Fleet.Actions.ControlForms, only: [charge: 1]

  alias Aerie.Control.{Commands, Missions}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Vehicle.Snapshot
  alias Aerie.Console.Commands.Catalog
  alias Aerie.Console.UI.Badge
  alias Aerie.Console.Pages.Fleet.{Plans, Selection}
  alias Aerie.Console.Pages.Fleet.Act.{Height, Mode}

  @most_reasons 20

  attr :selection, :map, required: true
  attr :all, :list, required: true
  attr :rows, :list, required: true
  attr :user, :map, required: true
  attr :plans, Plans, required: true

  @doc "What can be done with the selection. It takes the same room without one, but on a phone."
  def actions(assigns) do
    chosen = Selection.chosen(assigns.selection, assigns.all)
    ids = Enum.map(chosen, & &1.id)

    {seen, hidden} =
      Selection.summary(assigns.selection, ids, if(ids != [], do: Enum.map(assigns.rows, & &1.id), else: []))

    {ground, air} = Enum.split_with(chosen, &(&1.in_air != true))
    refusal = hidden && Selection.hidden_refusal()

    assigns =
      assign(assigns, chosen: chosen, value: %{ids: ids}, seen: seen, hidden: hidden, refusal: refusal)

    assigns = assign(assigns, able: able(chosen, assigns.user), locked: locked(chosen, assigns.user))
    assigns = assign(assigns, ground: offered(ground, "takeoff", assigns.user), mixed: air != [])
    climbing = if hidden == nil, do: offered(air, "set_altitude", assigns.user), else: []
    returning = if hidden == nil, do: offered(air, "rtl", assigns.user), else: []
    starting = if hidden == nil, do: offered(air, "mission_start", assigns.user), else: []
    # A mode is for all of them or for none.
    steered =
      if hidden == nil and length(offered(chosen, "set_mode", assigns.user)) == length(chosen),
        do: chosen,
        else: []

    # Those that have none are named on the sheet.
    missions? = match?([_, _ | _], chosen) and Enum.any?(kinds(chosen), &(Missions.gap(&1, :mission) == nil))
    assigns = assign(assigns, :missions, missions?)
    assigns = assign(assigns, air: climbing, returning: returning, starting: starting, steered: steered)

    ~H"""
    <div class="fleet-dock">
      <p :if={@chosen == []} class="muted">Select vehicles in the table or on the map.</p>
      <div :if={@chosen != []} id="fleet-actions" class="fleet-actions" role="group" aria-label="For the selected vehicles">
        <p class="fleet-selected">
          <strong :if={@seen}>{@seen}</strong>
          <strong :if={@hidden} class="fleet-hidden" role="status"><.icon name="alert" /> {@hidden}</strong>
          <.button :if={@hidden} small phx-click="show_hidden">Show them</.button>
        </p>
        <div :if={Roles.at_least?(@user.role, :operator)} class="row">
          <.hold_button
            :for={{type, label, icon, key} <- @able}
            id={"fleet-#{type}"}
            event="command"
            icon={icon}
            shortcut={key}
            refusal={@refusal}
            value={@value}
            phx-value-type={type}
          >{label}</.hold_button>
          <.button
            :for={{sheet, icon, ids, words} <- sheets(assigns)}
            icon={icon}
            disabled={@refusal != nil}
            title={@refusal}
            phx-click={JS.push("sheet_#{sheet}", value: Map.put(@value, :of, ids))}
          >{words} …</.button>
          <.button icon="tag" phx-click={JS.push("tag", value: @value)}>Tags</.button>
        </div>
        <.watching :if={@user.role == :viewer} />
        <p :for={text <- @locked} class="muted locked"><.icon name="lock" /> {text}</p>
        <.button icon="plan" phx-click={JS.push("plans", value: @value)} aria-pressed={to_string(Enum.all?(@chosen, &Plans.on?(@plans, &1.id)))}>Missions</.button>
        <.button kind="quiet" icon="x" label="Select none" phx-click="none" />
        <.why :if={Enum.any?(@chosen, & &1.readiness)} rows={@chosen} />
        <Mode.mode :if={@steered != []} value={@value} rows={@steered} />
        <Height.height :if={@air != []} value={@value} air={@air} />
        <.charge :if={@hidden == nil and Roles.at_least?(@user.role, :operator)} rows={@chosen} user={@user} />
      </div>
    </div>
    """
  end

  # The sheets that can be opened, each for those of the selected that it is for.
  defp sheets(%{ground: ground, returning: returning, starting: starting} = assigns) do
    for {true, sheet, icon, ids, words} <- [
          {ground != [], "take_off", "takeoff", ground,
           "Take off#{if assigns.mixed, do: " #{length(ground)}"}"},
          {length(returning) > 1, "return", "rtl", returning, "Return #{length(returning)}"},
          {length(starting) > 1, "start", "play", starting, "Start #{length(starting)} missions"},
          {assigns.missions, "mission", "plan", assigns.value.ids, "Mission to #{length(assigns.chosen)}"}
        ],
        do: {sheet, icon, ids, words}
  end

  attr :plans, Plans, required: true

  @doc "What is said of plans, over the map's lower part."
  def plan_words(assigns) do
    assigns = assign(assigns, :words, Plans.summary(assigns.plans))

    ~H"""
    <div :if={@words != []} class="fleet-plans">
      <p :for={words <- @words} class="hint" role="status">{words}</p>
    </div>
    """
  end

  attr :tagging, :map, required: true
  attr :words, :list, required: true

  @doc "The dialog for the tags of the vehicles that were selected when it was opened."
  def tag_dialog(assigns) do
    ~H"""
    <.dialog id="tags" title={"Tags of #{Selection.names(@tagging.ids)}"} cancel="close_tags">
      <form id="tags-form" phx-submit="save_tags">
        <.field
          id="tags-field"
          name="tags"
          label="Tags, separated by commas"
          value={@tagging.text}
          errors={List.wrap(@tagging.error)}
          hint={if @words != [], do: "In use: #{Enum.join(@words, ", ")}"}
          autocomplete="off"
          autofocus
        />
      </form>
      <:action><.button type="submit" kind="primary" form="tags-form" disabled={@tagging.left != []}>{save(@tagging.left)}</.button></:action>
    </.dialog>
    """
  end

  defp save([]), do: "Save"
  defp save(left), do: "Saving, #{length(left)} left"

  attr :rows, :list, required: true

  # Which of the selected vehicles on the ground are not ready, and why; open by a click, Enter or Space.
  defp why(assigns) do
    rows = Enum.filter(assigns.rows, & &1.readiness)
    {open, more} = rows |> Enum.reject(&(&1.readiness == :ready)) |> Enum.split(@most_reasons)

    words = rows |> Enum.map(& &1.readiness) |> Badge.counts()
    assigns = assign(assigns, words: words, open: open, more: length(more))

    ~H"""
    <details class="charge fleet-why" id="fleet-why" phx-mounted={JS.ignore_attributes("open")}>
      <summary><span>{@words}</span></summary>
      <div class="charge-forms">
        <p :if={@open == []}>All that are on the ground are ready.</p>
        <ul>
          <li :for={row <- @open} :key={row.id}>
            <strong>{row.id}</strong> <.readiness state={row.readiness} />
            <span class="muted">{Enum.join(row.open, " ")}</span>
          </li>
        </ul>
        <p :if={@more > 0} class="muted">and {@more} more</p>
      </div>
    </details>
    """
  end

  # The ids of those of a kind that the user can give this command.
  defp offered(_rows, _type, %{role: :viewer}), do: []

  defp offered(rows, type, user) do
    kinds =
      for kind <- kinds(rows),
          Commands.lacks(kind, type, user) == nil,
          do: {kind.autopilot, kind.vehicle_type}

    for row <- rows, {row.autopilot, row.kind} in kinds, do: row.id
  end

  # Those that the user may give to at least one of the selected vehicles. The results of the others say why not.
  defp able(chosen, user) do
    kinds = kinds(chosen)

    for {type, _label, _icon, _key} = action <- types(),
        Enum.any?(kinds, &(Commands.lacks(&1, type, user) == nil)),
        do: action
  end

  defp locked(_chosen, %{role: :viewer}), do: []

  defp locked(chosen, user) do
    names = for {type, label, _icon, _key} <- types(), do: {type, label}
    for kind <- kinds(chosen), text <- Catalog.locked(names, kind, user), uniq: true, do: text
  end

  # What counts is the same for all of a kind.
  defp kinds(chosen) do
    for row <- Enum.uniq_by(chosen, &{&1.autopilot, &1.kind}),
        do: %Snapshot{
          id: row.id,
          autopilot: row.autopilot,
          vehicle_type: row.kind,
          system_id: row.system_id
        }
  end

  defp types,
    do: [{"hold", "Hold", "hold", "H"}, {"rtl", "Return", "rtl", "R"}, {"land", "Land", "land", "L"}]
end
