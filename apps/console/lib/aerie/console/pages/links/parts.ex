defmodule Aerie.Console.Pages.Links.Parts do
  @moduledoc "The parts of the page of links."
  use Aerie.Console, :component

  alias Aerie.Console.Pages.Links.View
  alias Aerie.Console.UI.Age

  attr :rows, :list, required: true

  @doc "All links to vehicles."
  def link_table(assigns) do
    ~H"""
    <.data_table id="links" label="Links" rows={@rows} row_id={&"link-#{:erlang.phash2(&1.id)}"}>
      <:col :let={row} label="Link" class="grow">
        <.link patch={"/links?" <> URI.encode_query(link: row.id)}>{row.label || row.id}</.link>
      </:col>
      <:col :let={row} label="State"><.badge kind={kind(row.status)}>{row.status}</.badge> <.age us={row.age_us} /></:col>
      <:col :let={row} label="Network">{row.network}</:col>
      <:col :let={row} label="Frames/s" number>{round(row.in)}</:col>
      <:col :let={row} label="In, out" number>{rate(row.bytes_in)}, {rate(row.bytes_out)}</:col>
      <:col :let={row} label="Loss" number>{percent(row.loss)}</:col>
      <:col :let={row} label="Round trip" number>{ms(row.rtt)}</:col>
      <:col :let={row} label="Group">{row.group}<.badge :if={row.carries} kind="ok">active</.badge></:col>
      <:col :let={row} label="Dropped" number>{row.dropped}</:col>
    </.data_table>
    """
  end

  attr :networks, :list, required: true

  @doc "The networks: system ids belong to one."
  def networks(assigns) do
    ~H"""
    <section class="section">
      <h2>Networks</h2>
      <.data_table id="networks" label="Networks" rows={@networks} row_id={&"network-#{:erlang.phash2(&1.name)}"}>
        <:col :let={row} label="Network"><strong>{row.name}</strong></:col>
        <:col :let={row} label="Links" class="grow">{Enum.join(row.links, ", ")}</:col>
        <:col :let={row} label="Vehicles" number>{row.vehicles}</:col>
      </.data_table>
    </section>
    """
  end

  attr :link, :map, required: true
  attr :samples, :list, required: true
  attr :endpoints, :list, required: true
  attr :admin?, :boolean, required: true
  attr :now, :integer, required: true

  @doc "One link with all its details."
  def link_detail(assigns) do
    assigns =
      assign(assigns,
        row: View.link(assigns.link, assigns.now),
        sources: View.sources(assigns.link),
        counters: View.counters(assigns.link)
      )

    ~H"""
    <section id="link" class="stack">
      <div class="spread">
        <h2><.link patch="/links" aria-label="All links">Links</.link> › {@row.label || @row.id} <.badge kind={kind(@row.status)}>{@row.status}</.badge></h2>
        <div :if={@admin?} class="row">
          <.button icon="restart" phx-click="ask" phx-value-what="restart" phx-value-id={@row.id}>Restart</.button>
          <.button icon="trash" phx-click="ask" phx-value-what="remove" phx-value-id={@row.id}>Remove</.button>
        </div>
      </div>
      <.stale :if={@row.age_us && @row.age_us > 10_000_000}>Not heard for {Age.text(@row.age_us)}.</.stale>
      <p :for={finding <- @link.diagnosis || []} class="notice bad"><.icon name="alert" /> <span>{MavRouter.Link.Serial.Finding.format(finding)}{if finding.advice, do: ": #{finding.advice}"}</span></p>
      <div class="cards">
        <div class="card">
          <dl class="facts">
            <dt>State</dt>
            <dd>{@link.text}</dd>
            <dt>Address</dt>
            <dd class="mono">{@link.url}</dd>
            <dt>Local address</dt>
            <dd>{@link[:local] || "–"}</dd>
            <dt>Remote address</dt>
            <dd>{@link[:peer] || "–"}</dd>
            <dt>Network</dt>
            <dd>{@link.network}{if @row.group, do: ", group #{@row.group}"}</dd>
            <dt>Last heard</dt>
            <dd>{Age.text(@row.age_us)}{if @row.age_us, do: " ago"}</dd>
            <dt>Score</dt>
            <dd>{if @row.score, do: "#{round(@row.score)} of 100", else: "–"}</dd>
            <dt>Recording</dt>
            <dd>{recording(@link[:recording])}</dd>
          </dl>
          <details>
            <summary>As configuration</summary>
            <pre id="link-configuration" class="hex" tabindex="0">{View.configuration(@link)}</pre>
          </details>
        </div>
        <.chart title="Frames a second" line={View.line(@samples, :frames, 1)} text={"#{round(@row.in)}/s"} top={&"#{round(&1)}/s"} />
        <.chart title="Loss" line={View.line(@samples, :loss, 0.01)} text={percent(@row.loss)} top={&percent/1} />
        <.chart title="Round trip" line={View.line(@samples, :rtt, 1)} text={ms(@row.rtt)} top={&ms/1} />
      </div>
      <section :if={@sources != []}>
        <h3>Heard components</h3>
        <.data_table id="sources" label="Loss by component" rows={@sources} row_id={&"source-#{String.replace(&1.id, "/", "-")}"}>
          <:col :let={row} label="System/component">{row.id}</:col>
          <:col :let={row} label="Received" number>{row.received}</:col>
          <:col :let={row} label="Lost" number>{row.lost}</:col>
          <:col :let={row} label="Share" number>{percent(row.ratio)}</:col>
        </.data_table>
      </section>
      <section :if={@link.peers != []}>
        <h3>Peers</h3>
        <.data_table id="peers" label="Peers" rows={Enum.take(@link.peers, 100)} row_id={&"peer-#{:erlang.phash2(&1.peer)}"}>
          <:col :let={peer} label="Peer" class="grow">{peer.text}</:col>
          <:col :let={peer} label="Frames" number>{peer.frames_in}</:col>
          <:col :let={peer} label="Bytes" number>{peer.bytes_in}</:col>
          <:col :let={peer} label="Last heard" number>{Age.text(peer.silent_ms * 1000)} ago</:col>
        </.data_table>
      </section>
      <.endpoint_table :if={@endpoints != []} endpoints={@endpoints} title="Queues and drops" />
      <section :if={@counters != []}>
        <h3>Counters since the start</h3>
        <dl class="facts"><div :for={{name, n} <- @counters}><dt class="mono">{name}</dt><dd>{n}</dd></div></dl>
      </section>
    </section>
    """
  end

  attr :title, :string, required: true
  attr :line, :map, required: true
  attr :text, :string, required: true
  attr :top, :any, required: true

  defp chart(assigns) do
    ~H"""
    <figure class="card">
      <figcaption class="spread"><h3>{@title}</h3><strong>{@text}</strong></figcaption>
      <svg :if={@line} class="spark" viewBox="0 0 120 30" preserveAspectRatio="none" role="img" aria-label={"#{@title} of the last two minutes, at most #{@top.(@line.top)}"}><polyline points={@line.points} /></svg>
      <p :if={@line} class="muted">Maximum {@top.(@line.top)}; since this page was opened, up to two minutes</p>
      <p :if={@line == nil} class="muted">No data</p>
    </figure>
    """
  end

  attr :endpoints, :list, required: true
  attr :title, :string, required: true

  defp endpoint_table(assigns) do
    ~H"""
    <section>
      <h3>{@title}</h3>
      <.data_table id="endpoints" label={@title} rows={Enum.take(@endpoints, 200)} row_id={& &1.id}>
        <:col :let={row} label="Peer" class="grow">{row.peer}</:col>
        <:col :let={row} label="In" number>{round(row.in)}/s</:col>
        <:col :let={row} label="Out" number>{round(row.out)}/s, {rate(row.bytes_out)}</:col>
        <:col :let={row} label="Waiting" number>{row.waiting}</:col>
        <:col :let={row} label="Dropped" number>{row.dropped}</:col>
        <:col :let={row} label="Notes">{row.notes}</:col>
      </.data_table>
    </section>
    """
  end

  attr :endpoints, :list, required: true
  attr :admin?, :boolean, required: true

  @doc "The clients that are connected, or were heard."
  def client_table(assigns) do
    ~H"""
    <.empty :if={@endpoints == []} icon="users" title="No clients">Ground stations and programs appear here when they connect.</.empty>
    <.data_table :if={@endpoints != []} id="clients" label="Clients" rows={Enum.take(@endpoints, 200)} row_id={& &1.id}>
      <:col :let={row} label="Client"><strong>{row.owner}</strong></:col>
      <:col :let={row} label="Peer" class="grow">{row.peer}</:col>
      <:col :let={row} label="Kind">{row.kind}</:col>
      <:col :let={row} label="Access">{if row.role == :read_only, do: "read only", else: "may send"}</:col>
      <:col :let={row} label="Networks">{networks_text(row.networks)}</:col>
      <:col :let={row} label="In, out" number>{round(row.in)}/s, {round(row.out)}/s</:col>
      <:col :let={row} label="Waiting" number>{row.waiting}</:col>
      <:col :let={row} label="Dropped" number>{row.dropped}</:col>
      <:col :let={row} label="Notes">{row.notes}</:col>
      <:col :let={row} label=""><.button :if={@admin?} small icon="trash" label={"Remove client #{row.owner}"} phx-click="ask" phx-value-what="remove-client" phx-value-id={row.owner} /></:col>
    </.data_table>
    """
  end

  attr :rows, :list, required: true
  attr :admin?, :boolean, required: true

  @doc "The endpoints for clients."
  def client_endpoints(assigns) do
    ~H"""
    <section :if={@rows != []} class="section">
      <h2>Endpoints for clients</h2>
      <.data_table id="client-endpoints" label="Endpoints for clients" rows={@rows} row_id={&"client-endpoint-#{:erlang.phash2(&1.id)}"}>
        <:col :let={row} label="Endpoint"><strong>{row.id}</strong></:col>
        <:col :let={row} label="State"><.badge kind={kind(row.status)}>{row.status}</.badge></:col>
        <:col :let={row} label="What" class="grow">{row.text}</:col>
        <:col :let={row} label=""><.button :if={@admin?} small icon="trash" label={"Remove endpoint #{row.id}"} phx-click="ask" phx-value-what="remove-client" phx-value-id={row.id} /></:col>
      </.data_table>
    </section>
    """
  end

  attr :routes, :list, required: true
  attr :more, :integer, required: true

  @doc "The routes: which component is reached by which link."
  def route_table(assigns) do
    ~H"""
    <.empty :if={@routes == []} icon="link" title="No routes">The gateway learns a route from the first frame of a component.</.empty>
    <.data_table :if={@routes != []} id="routes" label="Routes" rows={@routes} row_id={& &1.id}>
      <:col :let={row} label="Network">{row.network}</:col>
      <:col :let={row} label="System/component">{row.system}/{row.component}</:col>
      <:col :let={row} label="Link">{row.link}</:col>
      <:col :let={row} label="Peer" class="grow">{row.peer}</:col>
      <:col :let={row} label="Heard" number>{Age.text(row.age_ms * 1000)} ago</:col>
      <:col :let={row} label="First heard" number>{Age.text(row.known_ms * 1000)} ago</:col>
    </.data_table>
    <p :if={@more > 0} class="muted">{@more} more.</p>
    """
  end

  attr :rules, :list, required: true
  attr :admin?, :boolean, required: true

  @doc "Rules that were changed at run time, with the configured ones."
  def rule_table(assigns) do
    ~H"""
    <.empty :if={@rules == []} icon="filter" title="No changed rules">
      Filters, rate limits and budgets are as configured. <code>PATCH /api/rules/ID</code> changes them.
    </.empty>
    <.data_table :if={@rules != []} id="rules" label="Changed rules" rows={@rules} row_id={&"rule-#{:erlang.phash2({&1.owner, &1.key})}"}>
      <:col :let={row} label="Link or client"><strong>{row.owner}</strong></:col>
      <:col :let={row} label="Rule">{row.key}</:col>
      <:col :let={row} label="Now" class="grow"><code>{value(row.change.now)}</code></:col>
      <:col :let={row} label="Configured"><code>{value(row.change.configured)}</code></:col>
      <:col :let={row} label=""><.button :if={@admin?} small phx-click="reset" phx-value-id={row.owner}>Reset all of {row.owner}</.button></:col>
    </.data_table>
    """
  end

  attr :asking, :any, required: true
  attr :form, :map, required: true
  attr :error, :string, required: true
  attr :networks, :list, required: true

  @doc "The dialogs before an action."
  def ask(%{asking: :add} = assigns) do
    ~H"""
    <.dialog id="add-link" title="Add a link" cancel="cancel">
      <form id="add-link-form" class="stack" phx-submit="add" phx-auto-recover="ignore" autocomplete="off">
        <.field id="add-url" name="url" label="Address" value={@form["url"]} required autofocus spellcheck="false" hint="udpin:0.0.0.0:14551, tcp:HOST:5760, serial:auto, /dev/ttyUSB0,57600, ws://HOST/PATH" errors={List.wrap(@error)} />
        <.field id="add-id" name="id" label="Name" value={@form["id"]} hint="Default: the address" />
        <.field id="add-network" name="network" label="Network" value={@form["network"]} hint="Default: main" />
        <p class="muted">
          Temporary: gone when the gateway stops. Its page has it as configuration, to make it permanent.
        </p>
        <.button type="submit" kind="primary">Add</.button>
      </form>
    </.dialog>
    """
  end

  def ask(%{asking: {what, id}} = assigns) do
    assigns = assign(assigns, what: what, id: id)

    ~H"""
    <.dialog id="confirm-link" title={title(@what, @id)} cancel="cancel" kind="danger">
      <p>{consequence(@what)}</p>
      <:action>
        <.button phx-click="cancel">Cancel</.button>
        <.button kind="danger" phx-click={@what} phx-value-id={@id}>{title(@what, @id)}</.button>
      </:action>
    </.dialog>
    """
  end

  defp title("remove", id), do: "Remove link #{id}"
  defp title("restart", id), do: "Restart link #{id}"
  defp title("remove-client", id), do: "Remove client #{id}"

  defp consequence("remove"),
    do:
      "The gateway no longer hears the vehicles on this link, even those in the air. A configured link returns when the gateway starts again."

  defp consequence("restart"),
    do:
      "The connection is closed and opened again. Frames that arrive meanwhile are lost; counters and routes stay."

  defp consequence("remove-client"),
    do: "Its connections are closed. A ground station may reconnect by itself."

  defp kind(status) when status in [:up], do: "ok"
  defp kind(:connecting), do: "warn"
  defp kind(status) when status in [:idle, :ended], do: "off"
  defp kind(_down), do: "bad"

  defp recording(nil), do: "none"
  defp recording(%{state: :paused, reason: reason}), do: "paused: #{reason}"
  defp recording(%{state: state, file: file}) when file != nil, do: "#{state}, #{Path.basename(file)}"
  defp recording(%{state: state}), do: "#{state}"

  defp networks_text(:all), do: "all"
  defp networks_text(names), do: Enum.join(names, ", ")

  defp value(nil), do: "–"
  defp value(text) when is_binary(text), do: text
  defp value(other), do: inspect(other, limit: 20, printable_limit: 200)

  defp rate(n) when n < 10_000, do: "#{round(n)} B/s"
  defp rate(n), do: "#{round(n / 1000)} kB/s"

  defp percent(nil), do: "–"
  defp percent(share), do: "#{:erlang.float_to_binary(share * 100 / 1, decimals: 1)} %"

  defp ms(nil), do: "–"
  defp ms(ms), do: "#{round(ms)} ms"
end
