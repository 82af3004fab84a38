defmodule Aerie.Console.Pages.System.Page do
  @moduledoc "Load, memory, heartbeat, NATS, versions. `top()` and `sup()` of the shell show more."
  use Aerie.Console, :page

  alias Aerie.Console.Pages.System.Figures
  alias Aerie.Console.UI.Age

  # Each second is too often to measure.
  @every 2

  @impl Phoenix.LiveView
  def mount(_params, _session, socket) do
    {:ok, socket |> assign(page_title: "System", turn: 0, figures: nil) |> subscribe([]) |> load()}
  end

  @impl Phoenix.LiveView
  def handle_params(_params, _uri, socket), do: {:noreply, socket}

  @impl Phoenix.LiveView
  def handle_info(:refresh, %{assigns: %{turn: turn}} = socket) do
    socket = assign(socket, :turn, rem(turn + 1, @every))
    {:noreply, if(turn == 0, do: load(socket), else: socket)}
  end

  defp load(%{assigns: %{gateway: gateway, figures: before}} = socket),
    do: if(connected?(socket), do: assign(socket, :figures, Figures.of(gateway, before)), else: socket)

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <h1 class="page-title">System</h1>
    <.loading :if={@figures == nil} />
    <div :if={@figures} id="system-overview" class="cards">
      <.gateway figures={@figures} />
      <.nats nats={@figures.nats} off?={@figures.nats_off?} />
      <section class="card">
        <h2>Versions</h2>
        <dl class="facts">
          <div :for={{name, version} <- @figures.versions}>
            <dt>{name}</dt>
            <dd>{version}</dd>
          </div>
        </dl>
      </section>
    </div>
    <p class="muted">Processes and restarts: <code>top()</code> and <code>sup()</code> in <code>aerie remote</code>.</p>
    """
  end

  defp gateway(assigns) do
    ~H"""
    <section class="card">
      <h2>Gateway</h2>
      <dl class="facts">
        <dt>Up</dt>
        <dd>{Age.text(@figures.uptime_ms * 1000)}</dd>
        <dt>Heartbeat</dt>
        <dd>{heartbeat(@figures.identity)}</dd>
        <dt>Processor time</dt>
        <dd>{cpu(@figures)}</dd>
        <dt>Memory</dt>
        <dd>{bytes(@figures.memory)}</dd>
        <dt>Nearest limit</dt>
        <dd>{limit(@figures.limit)}</dd>
      </dl>
    </section>
    """
  end

  defp nats(%{nats: nil} = assigns) do
    ~H"""
    <section class="card">
      <h2>NATS</h2>
      <p :if={@off?} class="muted">Off in the configuration (nats.mode: off).</p>
      <p :if={!@off?} class="muted">The bridge is not running.</p>
    </section>
    """
  end

  defp nats(assigns) do
    ~H"""
    <section class="card">
      <h2>
        NATS <.badge :if={@nats.problem} kind="bad">problem</.badge>
        <.badge :if={!@nats.problem} kind="ok">stores events</.badge>
      </h2>
      <dl class="facts">
        <dt :if={@nats.problem}>Problem</dt>
        <dd :if={@nats.problem}>{@nats.problem}</dd>
        <dt>Server</dt>
        <dd>{@nats.url || "–"} ({@nats.mode})</dd>
        <dt :if={@nats.server}>Restarts</dt>
        <dd :if={@nats.server}>{@nats.server[:restarts] || 0}</dd>
        <dt>Outbox</dt>
        <dd>{outbox(@nats.outbox)}</dd>
        <dt>In flight</dt>
        <dd>{@nats.outbox[:in_flight] || 0}</dd>
        <dt>Streams</dt>
        <dd>{streams(@nats.streams)}</dd>
      </dl>
    </section>
    """
  end

  defp outbox(outbox),
    do: "#{outbox[:events] || 0} events, #{bytes(outbox[:bytes] || 0)}, #{outbox[:dropped] || 0} dropped"

  defp cpu(%{cpu: cpu, schedulers: n}) when is_number(cpu), do: "#{round(cpu)} % of one core (there are #{n})"
  defp cpu(_first), do: "measuring…"

  defp limit({name, used, most}), do: "#{name}, #{used} of #{most}"

  defp heartbeat(%{alive: true}), do: "OK"
  defp heartbeat(%{silent: []}), do: "not checked"

  defp heartbeat(%{silent: silent}),
    do: "no answer from #{Enum.map_join(silent, ", ", fn {role, _id} -> role end)}"

  defp streams(streams) when streams == %{}, do: "–"
  defp streams(streams), do: Enum.map_join(streams, ", ", fn {name, state} -> "#{name}: #{stream(state)}" end)

  defp stream(state) when is_atom(state) or is_binary(state), do: "#{state}"
  defp stream(other), do: inspect(other, limit: 5, printable_limit: 80)

  defp bytes(n) when n < 10_240, do: "#{n} B"
  defp bytes(n) when n < 10_485_760, do: "#{div(n, 1024)} KiB"
  defp bytes(n) when n < 10_737_418_240, do: "#{div(n, 1_048_576)} MiB"
  defp bytes(n), do: "#{div(n, 1_073_741_824)} GiB"
end
