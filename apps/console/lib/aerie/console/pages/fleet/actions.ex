defmodule Aerie.Console.Pages.Fleet.Actions do
  @moduledoc "The actions for the selected vehicles, with the result for each. Their events say for which vehicles the operator saw them."
  use Aerie.Console, :component

  import Aerie.Console.Pages.Fleet.Actions.ControlForms, only: [charge: 1]

  alias Aerie.Control.Commands
  alias Aerie.Control.Policy.Roles
  alias Aerie.Vehicle.Snapshot
  alias Aerie.Console.Commands.Catalog
  alias Aerie.Console.Pages.Fleet.{Plans, Selection}
  alias Aerie.Console.Commands.Batch

  attr :selection, :map, required: true
  attr :all, :list, required: true
  attr :rows, :list, required: true
  attr :user, :map, required: true
  attr :plans, Plans, required: true

  @doc "Hold, return and land for the selection, who is in charge of it, its plans on the map and its tags. It takes the same room without a selection."
  def actions(assigns) do
    chosen = Selection.chosen(assigns.selection, assigns.all)
    ids = Enum.map(chosen, & &1.id)

    {seen, hidden} =
      Selection.summary(assigns.selection, ids, if(ids != [], do: Enum.map(assigns.rows, & &1.id), else: []))

    assigns = assign(assigns, chosen: chosen, value: %{ids: ids}, seen: seen, hidden: hidden)
    assigns = assign(assigns, able: able(chosen, assigns.user), locked: locked(chosen, assigns.user))

    ~H"""
    <div class="fleet-dock">
      <p :if={@chosen == []} class="muted">Select vehicles in the table or on the map.</p>
      <div :if={@chosen != []} id="fleet-actions" class="fleet-actions" role="group" aria-label="For the selected vehicles">
        <p class="fleet-selected">
          <strong :if={@seen}>{@seen}</strong>
          <strong :if={@hidden} class="fleet-hidden" role="status"><.icon name="alert" /> {@hidden}</strong>
        </p>
        <div :if={Roles.at_least?(@user.role, :operator)} class="row">
          <.hold_button
            :for={{type, label, icon, key} <- @able}
            id={"fleet-#{type}"}
            event="command"
            icon={icon}
            shortcut={key}
            refusal={@hidden && "#{label} does nothing: #{Selection.hidden_refusal(@hidden)}"}
            value={@value}
            phx-value-type={type}
          >{label}</.hold_button>
          <.button icon="tag" phx-click={JS.push("tag", value: @value)}>Tags</.button>
        </div>
        <p :for={text <- @locked} class="muted locked"><.icon name="lock" /> {text}</p>
        <.button icon="plan" phx-click={JS.push("plans", value: @value)} aria-pressed={to_string(Enum.all?(@chosen, &Plans.on?(@plans, &1.id)))}>Missions</.button>
        <.button kind="quiet" icon="x" label="Select none" phx-click="none" />
        <.charge :if={@hidden == nil and Roles.at_least?(@user.role, :operator)} rows={@chosen} user={@user} />
      </div>
    </div>
    """
  end

  attr :batch, :map, required: true
  attr :plans, Plans, required: true

  @doc "The results of the last action, and what is said of plans, over the map's lower part."
  def results(assigns) do
    assigns = assign(assigns, :words, Plans.summary(assigns.plans))

    ~H"""
    <div :if={@batch != nil or @words != []} class="fleet-results">
      <section :if={@batch} id="fleet-batch" class="fleet-batch card" aria-label="Results">
        <header class="spread">
          <h2>{title(@batch)}</h2>
          <.button kind="quiet" icon="x" label="Close" phx-click="close_batch" />
        </header>
        <ul aria-live="polite">
          <li :for={entry <- Batch.by_need(@batch)} :key={entry.id}>
            <span>{entry.vehicle}</span>
            <.badge kind={kind(@batch, entry)}>{word(@batch, entry)}</.badge>
            <span class="muted">{reason(entry.state)}</span>
          </li>
        </ul>
      </section>
      <p :for={words <- @words} class="hint fleet-plans" role="status">{words}</p>
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

  defp title(batch) do
    {over, not_done} = Batch.count(batch)
    failed = if not_done > 0, do: ", #{not_done} not done"
    "#{Catalog.title(batch.type)}: #{over} of #{length(batch.entries)} ended#{failed}"
  end

  defp save([]), do: "Save"
  defp save(left), do: "Saving, #{length(left)} left"

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

  defp kind(batch, entry), do: batch.type |> Batch.badge(entry.state) |> elem(0)
  defp word(batch, entry), do: batch.type |> Batch.badge(entry.state) |> elem(1)
  defp reason({:done, _status, reason}), do: reason
  defp reason(_state), do: nil
end
