defmodule Aerie.Console.Pages.Shadow.Parts do
  @moduledoc "The parts of the page of a shadow."
  use Aerie.Console, :component

  alias Aerie.Fleet.Shadow
  alias Aerie.Console.Pages.Shadow.{Input, Rows}

  attr :rows, :list, required: true, doc: "`t:Aerie.Console.Pages.Shadow.Rows.row/0`"
  attr :version, :integer, required: true, doc: "that is shown: a change is one of it"

  @doc "The desired state, and the status of each field."
  def fields(assigns) do
    ~H"""
    <.data_table id="shadow" label="Wanted and actual" rows={@rows} row_id={&"field-#{&1.path}"}>
      <:col :let={row} label="Field"><code>{row.path}</code></:col>
      <:col :let={row} label="Wanted"><strong class="mono">{row.desired}</strong></:col>
      <:col :let={row} label="Actual"><span class="mono">{row.actual || "–"}</span></:col>
      <:col :let={row} label="State"><.badge kind={kind(row.state)}>{row.state || "not compared"}</.badge> <span :if={row.why} class="muted">{row.why}</span></:col>
      <:col :let={row} label="Set by">{row.set}<span :if={row.expires} class="muted">, ends {row.expires}</span></:col>
      <:col :let={row} label="">
        <div :if={row.able} class="row">
          <.button small icon="params" phx-click="edit" phx-value-path={row.path}>Change</.button>
          <.button small icon="trash" phx-click={JS.push("remove", value: %{path: row.path, version: @version})} label={"Remove #{row.path}"} />
        </div>
      </:col>
    </.data_table>
    """
  end

  defp kind("converged"), do: "ok"
  defp kind("pending"), do: "info"
  defp kind("held"), do: "warn"
  defp kind("refused"), do: "bad"
  defp kind(nil), do: "plain"

  attr :form, :map, required: true
  attr :names, :list, required: true
  attr :version, :integer, required: true, doc: "that is shown: a change is one of it"
  attr :error, :string, required: true

  @doc "The form to desire something."
  def desire(assigns) do
    field = Enum.find(Shadow.fields(), &(&1.name == assigns.form["field"]))
    assigns = assign(assigns, field: field, named: field != nil and String.ends_with?(field.name, "*"))

    ~H"""
    <section class="card" aria-labelledby="desire-title">
      <h2 id="desire-title">Set a wanted value</h2>
      <form id="desire" class="form-row" phx-hook="CommandForm" phx-change="form" phx-auto-recover="ignore">
        <input type="hidden" name="version" value={@version} />
        <.field id="desire-field" name="field" type="select" label="Field" options={[{"choose", ""} | Enum.map(@names, &{&1, &1})]} value={@form["field"]} hint={@field && @field.meaning} />
        <.field :if={@named} id="desire-name" name="name" label={if @form["field"] == "params.*", do: "Parameter", else: "Message"} value={@form["name"]} autocomplete="off" />
        <.field :if={@field} id="desire-value" name="value" label="Value" value={@form["value"]} hint={hint(@field)} autocomplete="off" />
        <.field :if={@field} id="desire-expires" name="expires" type="select" label="Ends" options={Input.expiries()} value={@form["expires"]} />
        <.field :if={@field} id="desire-reason" name="reason" label="Reason" maxlength="200" value={@form["reason"]} autocomplete="off" />
        <.hold_button :if={@field} id="desire-set" event="desire">Set</.hold_button>
      </form>
      <p :if={@error} class="notice bad" role="alert">{@error}</p>
      <p class="hint">The gateway applies this when it is allowed and nobody else is in control. It never takes off.</p>
    </section>
    """
  end

  defp hint(%{name: "tags"}), do: "words, separated by commas"
  defp hint(%{name: "home"}), do: "latitude, longitude, height above sea in metres"
  defp hint(%{name: "intervals.*"}), do: "times a second"

  defp hint(%{name: name}) when name in ["mission.plan", "geofence.plan"],
    do: "the hash that POST /api/plans gave"

  defp hint(%{name: name}) when name in ["recorder", "armed", "geofence.enabled"], do: "true or false"
  defp hint(%{name: "signing"}), do: "true"
  defp hint(_field), do: nil

  attr :history, :list, required: true

  @doc "The latest changes."
  def history(assigns) do
    ~H"""
    <section class="card" aria-labelledby="history-title">
      <h2 id="history-title">Changes</h2>
      <p :if={@history == []} class="muted">No changes yet</p>
      <ol :if={@history != []} class="stack" id="shadow-history">
        <li :for={change <- @history} :key={change["version"]} id={"change-#{change["version"]}"}>
          <strong>{change["version"]}</strong> {Rows.set(change)}
          <span :if={change["set"] != []}>set <code>{Enum.join(change["set"], ", ")}</code></span>
          <span :if={change["removed"] != []}>removed <code>{Enum.join(change["removed"], ", ")}</code></span>
        </li>
      </ol>
    </section>
    """
  end
end
