defmodule Aerie.Console.Pages.Inspector.Parts do
  @moduledoc "The parts of the inspector's page."
  use Aerie.Console, :component

  alias Aerie.Fleet.Inspector
  alias Aerie.Console.UI.Age

  attr :filter, :map, required: true
  attr :choices, :map, required: true

  @doc "The filter."
  def filters(assigns) do
    ~H"""
    <form id="inspector-filter" class="tools" phx-change="filter" phx-submit="filter" role="search">
      <.field id="filter-text" name="text" label="Name or id" type="search" value={@filter["text"]} phx-debounce="150" autocomplete="off" />
      <.field id="filter-vehicle" name="vehicle" label="Vehicle" type="select" value={@filter["vehicle"]} options={[{"all", ""} | @choices.vehicle]} />
      <.field id="filter-component" name="component" label="Component" type="select" value={@filter["component"]} options={[{"all", ""} | @choices.component]} />
      <.field id="filter-link" name="link" label="Link" type="select" value={@filter["link"]} options={[{"all", ""} | @choices.link]} />
      <.field id="filter-direction" name="direction" label="Direction" type="select" value={@filter["direction"]} options={[{"both", ""}, {"received", "in"}, {"sent", "out"}]} />
    </form>
    """
  end

  attr :direction, :atom, required: true

  @doc "The direction: received or sent."
  def direction(assigns) do
    ~H"""
    <.badge kind={if(@direction == :in, do: "plain", else: "info")}>{if @direction == :in, do: "in", else: "out"}</.badge>
    """
  end

  attr :detail, :map, required: true

  @doc "The last frame of a message: fields and bytes."
  def message(assigns) do
    ~H"""
    <section class="card" id="message" aria-label="The chosen message">
      <div class="spread">
        <h2 class="mono">{@detail.name}</h2>
        <.button kind="quiet" icon="x" label="Close" phx-click="close" />
      </div>
      <.stale :if={@detail.gone?}>Not received for a minute</.stale>
      <p class="muted">
        Message {@detail.frame.id}, MAVLink {@detail.frame.version}, from {@detail.frame.system}/{@detail.frame.component}, sequence {@detail.frame.seq}{if @detail.frame.signature, do: ", signed"}
      </p>
      <.empty :if={@detail.fields == nil} title="Unknown message">The gateway's dialects do not define it, so only its bytes are shown.</.empty>
      <.data_table :if={@detail.fields} id="fields" label="Fields" rows={@detail.fields} row_id={&"field-#{&1.name}"}>
        <:col :let={field} label="Field"><span class="mono">{field.name}</span></:col>
        <:col :let={field} label="Value" class="grow"><span class="mono">{field.value}</span> {field.units}</:col>
        <:col :let={field} label="Means">{field.means}</:col>
        <:col :let={field} label="Type"><span class="muted">{field.type}</span></:col>
      </.data_table>
      <h3>Bytes ({byte_size(@detail.frame.bytes)})</h3>
      <pre class="hex">{@detail.hex}</pre>
    </section>
    """
  end

  attr :log, :list, required: true
  attr :now, :integer, required: true

  @doc "The messages sent from this page, with the answers."
  def sent(assigns) do
    ~H"""
    <section class="section" id="sent">
      <h2>Sent</h2>
      <ul class="stack">
        <li :for={entry <- @log} :key={entry.n} id={"sent-#{entry.n}"} class="card">
          <div class="spread">
            <strong class="mono">{entry.name}</strong>
            <span><.badge kind={kind(entry.outcome)}>{label(entry.outcome)}</.badge> <span class="muted">{Age.text(max(@now - entry.at, 0))} ago</span></span>
          </div>
          <p :if={entry.text}>{entry.text}</p>
          <p :if={entry.answers == [] && entry.outcome == :sent} class="muted">No answer within 1.5 s</p>
          <dl :for={{name, fields} <- entry.answers} class="facts">
            <dt class="mono">{name}</dt>
            <dd>{summary(fields)}</dd>
          </dl>
        </li>
      </ul>
    </section>
    """
  end

  attr :compose, :map, required: true
  attr :networks, :list, required: true
  attr :sending?, :boolean, required: true

  @doc "The form of a message. A reconnection does not send it again."
  def compose_dialog(assigns) do
    ~H"""
    <.dialog id="compose" title="Send a message" cancel="discard">
      <p class="notice warn">
        <.icon name="alert" />
        <span>The policy checks commands sent here, and the audit log records them. Prefer the vehicle's page for commands.</span>
      </p>
      <form id="compose-form" class="stack" phx-change="composed" phx-submit="send" phx-auto-recover="ignore" autocomplete="off">
        <.field id="compose-message" name="message" label="Message" type="select" value={@compose.name} options={Inspector.message_names()} errors={List.wrap(@compose.errors["message"])} />
        <.field id="compose-network" name="network" label="Network" type="select" options={[{"all", ""} | Enum.map(@networks, &{&1, &1})]} />
        <div :for={field <- @compose.fields} :key={field.name}>
          <.field
            id={"compose-#{field.name}"}
            name={"field[#{field.name}]"}
            label={field.name}
            value={@compose.texts[field.name]}
            unit={field.units}
            hint={hint(field)}
            errors={List.wrap(@compose.errors[field.name])}
            list={field.choices != [] && "choices-#{field.name}"}
            spellcheck="false"
          />
          <datalist :if={field.choices != []} id={"choices-#{field.name}"}>
            <option :for={{name, value} <- Enum.take(field.choices, 300)} value={name}>{value}</option>
          </datalist>
        </div>
        <.button type="submit" kind="primary" icon="upload" disabled={@sending?}>{if @sending?, do: "Sending …", else: "Send"}</.button>
      </form>
    </.dialog>
    """
  end

  defp hint(field) do
    type = if field.length, do: "#{field.type}[#{field.length}]", else: "#{field.type}"
    enum = if field.enum, do: ", " <> (field.enum |> Module.split() |> List.last())
    "#{type}#{enum}#{if field.extension, do: ", MAVLink 2 only"}"
  end

  defp summary(fields),
    do:
      Enum.map_join(fields, ", ", fn field -> "#{field.name} #{field.means || field.value}" end)
      |> String.slice(0, 300)

  @doc "A rate in words."
  @spec hz(float()) :: String.t()
  def hz(hz) when hz < 0.05, do: "–"
  def hz(hz) when hz < 10, do: "#{Float.round(hz, 1)} Hz"
  def hz(hz), do: "#{round(hz)} Hz"

  defp kind(:sent), do: "ok"
  defp kind(_other), do: "bad"

  defp label(:sent), do: "sent"
  defp label(:denied), do: "denied"
  defp label(:no_route), do: "no vehicle with these ids"
  defp label(:failed), do: "not sent"
end
