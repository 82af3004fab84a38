defmodule FleetWeb.Console.Fleet.Actions do
  @moduledoc "The actions for the selected vehicles, with the result for each."
  use FleetWeb.Console, :component

  import FleetWeb.Console.Fleet.Charge, only: [charge: 1]

  alias FleetWeb.Console.Access.Role
  alias FleetWeb.Console.Fleet.{Batch, Plans, Selection}

  attr :selection, :map, required: true
  attr :all, :list, required: true
  attr :user, :map, required: true
  attr :batch, :map, default: nil
  attr :plans, Plans, required: true

  @doc "Hold, return and land for the selection, who is in charge of it, its plans on the map, its tags, and the results of the last action."
  def actions(assigns) do
    assigns = assign(assigns, :chosen, Enum.filter(assigns.all, &(&1.id in assigns.selection.ids)))

    ~H"""
    <div :if={Selection.size(@selection) > 0} id="fleet-actions" class="fleet-actions" role="group" aria-label="For the selected vehicles">
      <strong class="fleet-selected">{names(@selection, @all)}</strong>
      <div :if={Role.at_least?(@user.role, :operator)} class="row">
        <.hold_button :for={{type, label, icon, key} <- types()} id={"fleet-#{type}"} event="command" icon={icon} shortcut={key} phx-value-type={type}>{label}</.hold_button>
        <.button icon="tag" phx-click="tag">Tags</.button>
      </div>
      <.button icon="plan" phx-click="plans" aria-pressed={to_string(@chosen != [] and Enum.all?(@chosen, &Plans.on?(@plans, &1.id)))}>Missions</.button>
      <.button kind="quiet" icon="x" label="Select none" phx-click="none" />
      <.charge :if={Role.at_least?(@user.role, :operator)} rows={@chosen} user={@user} />
    </div>
    <p :for={words <- Plans.words(@plans)} class="hint fleet-plans" role="status">{words}</p>
    <section :if={@batch} id="fleet-batch" class="fleet-batch card" aria-label="Results">
      <header class="spread">
        <h2>{title(@batch.type)}: {Batch.done(@batch)} of {length(@batch.entries)} done</h2>
        <.button kind="quiet" icon="x" label="Close" phx-click="close_batch" />
      </header>
      <ul aria-live="polite">
        <li :for={entry <- @batch.entries} :key={entry.id}>
          <span>{entry.vehicle}</span>
          <.badge kind={kind(entry.state)}>{word(entry.state)}</.badge>
          <span class="muted">{reason(entry.state)}</span>
        </li>
      </ul>
    </section>
    """
  end

  attr :tagging, :map, required: true
  attr :count, :integer, required: true
  attr :words, :list, required: true

  @doc "The dialog for the tags of the selected vehicles."
  def tag_dialog(assigns) do
    ~H"""
    <.dialog id="tags" title={"Tags of #{@count} #{if @count == 1, do: "vehicle", else: "vehicles"}"} cancel="close_tags">
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

  defp title("take_control"), do: "TAKE CHARGE"
  defp title("release_control"), do: "RELEASE"
  defp title(type), do: String.upcase(type)

  defp save([]), do: "Save"
  defp save(left), do: "Saving, #{length(left)} left"

  defp types,
    do: [{"hold", "Hold", "hold", "H"}, {"rtl", "Return", "rtl", "R"}, {"land", "Land", "land", "L"}]

  defp names(selection, all) do
    case Selection.among(selection, Enum.map(all, & &1.id)) do
      [id] -> id
      ids when length(ids) <= 3 -> Enum.join(ids, ", ")
      ids -> "#{length(ids)} vehicles"
    end
  end

  defp kind(state), do: state |> Batch.shown() |> elem(0)
  defp word(state), do: state |> Batch.shown() |> elem(1)
  defp reason({:done, _status, reason}), do: reason
  defp reason(_state), do: nil
end
