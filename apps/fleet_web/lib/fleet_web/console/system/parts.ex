defmodule FleetWeb.Console.System.Parts do
  @moduledoc "The parts of the system page."
  use FleetWeb.Console, :component

  alias FleetWeb.Console.UI.Age

  # In a large fleet nobody opens the trees of all vehicles at once.
  @max_children 50

  attr :facts, :map, required: true

  @doc "Load of the virtual machine."
  def machine(assigns) do
    ~H"""
    <section class="card">
      <h2>Virtual machine</h2>
      <dl class="facts">
        <dt>Up</dt>
        <dd>{Age.text(@facts.uptime_ms * 1000)}</dd>
        <dt>Processor time</dt>
        <dd>{cpu(@facts)}</dd>
        <dt>Run queue</dt>
        <dd>{Enum.sum(@facts.run_queues)}</dd>
        <dt>Schedulers</dt>
        <dd>{@facts.schedulers}</dd>
        <dt>Read, written</dt>
        <dd>{bytes(@facts.io.input)}, {bytes(@facts.io.output)}</dd>
        <dt>Heartbeat</dt>
        <dd>{heartbeat(@facts.identity)}</dd>
      </dl>
    </section>
    """
  end

  attr :facts, :map, required: true

  @doc "Memory by its use."
  def memory(assigns) do
    ~H"""
    <section class="card">
      <h2>Memory</h2>
      <dl class="facts">
        <dt>Total</dt>
        <dd>{bytes(@facts.memory.total)}</dd>
        <div :for={name <- [:processes, :binary, :ets, :code, :atom]}>
          <dt>{name}</dt>
          <dd>{bytes(Map.fetch!(@facts.memory, name))}</dd>
        </div>
      </dl>
    </section>
    """
  end

  attr :facts, :map, required: true

  @doc "The limits of the virtual machine."
  def limits(assigns) do
    ~H"""
    <section class="card">
      <h2>Limits</h2>
      <dl class="facts">
        <div :for={limit <- @facts.limits}>
          <dt>{limit.name}</dt>
          <dd><.meter value={limit.used / limit.most} label={limit.name} text={"#{limit.used} of #{limit.most}"} kind={limit_kind(limit)} /></dd>
        </div>
      </dl>
    </section>
    """
  end

  attr :facts, :map, required: true

  @doc "The connection to NATS, its streams and the outbox."
  def nats(%{facts: %{nats: nil}} = assigns) do
    ~H"""
    <section class="card">
      <h2>NATS</h2>
      <p class="muted">{if @facts.nats_off?, do: "Off in the configuration (nats.mode: off).", else: "The bridge is not running."}</p>
    </section>
    """
  end

  def nats(assigns) do
    ~H"""
    <section class="card">
      <h2>NATS <.badge kind={if(@facts.nats.problem, do: "bad", else: "ok")}>{if @facts.nats.problem, do: "problem", else: "stores events"}</.badge></h2>
      <dl class="facts">
        <dt :if={@facts.nats.problem}>Problem</dt>
        <dd :if={@facts.nats.problem}>{@facts.nats.problem}</dd>
        <dt>Server</dt>
        <dd>{@facts.nats.url || "–"} ({@facts.nats.mode})</dd>
        <dt :if={@facts.nats.server}>Restarts</dt>
        <dd :if={@facts.nats.server}>{@facts.nats.server[:restarts] || 0}</dd>
        <dt>Outbox</dt>
        <dd>{@facts.nats.outbox[:events] || 0} events, {bytes(@facts.nats.outbox[:bytes] || 0)}, {@facts.nats.outbox[:dropped] || 0} dropped</dd>
        <dt>In flight</dt>
        <dd>{@facts.nats.outbox[:in_flight] || 0}</dd>
        <dt>Streams</dt>
        <dd>{streams(@facts.nats.streams)}</dd>
      </dl>
    </section>
    """
  end

  attr :facts, :map, required: true

  @doc "Versions and times."
  def versions(assigns) do
    ~H"""
    <section class="card">
      <h2>Versions</h2>
      <dl class="facts">
        <div :for={{name, version} <- @facts.versions}>
          <dt>{name}</dt>
          <dd>{version}</dd>
        </div>
        <dt>System</dt>
        <dd>{@facts.os}</dd>
      </dl>
    </section>
    """
  end

  attr :node, :map, required: true
  attr :now, :integer, required: true
  attr :depth, :integer, required: true

  @doc "A process of the supervision tree with its children."
  def tree_node(assigns) do
    assigns =
      assign(assigns,
        shown: Enum.take(assigns.node.children, @max_children),
        more: length(assigns.node.children) - @max_children,
        id: "node-#{:erlang.phash2(assigns.node.path, 4_294_967_296)}"
      )

    ~H"""
    <li role="treeitem" aria-level={@depth}>
      <details :if={@shown != []} id={@id} open={@depth <= 2} phx-mounted={JS.ignore_attributes("open")}>
        <summary><.process node={@node} now={@now} /></summary>
        <ul role="group">
          <.tree_node :for={child <- @shown} node={child} now={@now} depth={@depth + 1} />
          <li :if={@more > 0} class="muted">and {@more} more</li>
        </ul>
      </details>
      <div :if={@shown == []} class="tree-leaf"><.process node={@node} now={@now} /></div>
    </li>
    """
  end

  attr :node, :map, required: true
  attr :now, :integer, required: true

  defp process(assigns) do
    ~H"""
    <span class="tree-name">{@node.name}</span>
    <.badge :if={@node.pid == nil} kind="off">not running</.badge>
    <span :if={@node.memory} class="muted">{bytes(@node.memory)}</span>
    <.badge :if={(@node.queue || 0) > 100} kind="warn">{@node.queue} messages waiting</.badge>
    <.badge :if={@node.restarts} kind="bad">{restarted(@node.restarts, @now)}</.badge>
    <span :if={@node.restarts} class="muted">{@node.restarts.reason}</span>
    """
  end

  defp restarted(%{count: 1, at: at}, now), do: "restarted #{Age.text(now - at)} ago"
  defp restarted(%{count: n, at: at}, now), do: "#{n} restarts, last #{Age.text(now - at)} ago"

  @doc "A number of bytes in words."
  @spec bytes(non_neg_integer()) :: String.t()
  def bytes(n) when n < 10_240, do: "#{n} B"
  def bytes(n) when n < 10_485_760, do: "#{div(n, 1024)} KiB"
  def bytes(n) when n < 10_737_418_240, do: "#{div(n, 1_048_576)} MiB"
  def bytes(n), do: "#{div(n, 1_073_741_824)} GiB"

  defp cpu(%{cpu: cpu, schedulers: n}) when is_number(cpu), do: "#{round(cpu)} % of one core (there are #{n})"
  defp cpu(_first), do: "measuring…"

  defp heartbeat(%{alive: true}), do: "OK"
  defp heartbeat(%{silent: []}), do: "not checked"

  defp heartbeat(%{silent: silent}),
    do: "no answer from #{Enum.map_join(silent, ", ", fn {role, _id} -> "#{role}" end)}"

  defp limit_kind(%{used: used, most: most}) when used > most * 0.8, do: "bad"
  defp limit_kind(%{used: used, most: most}) when used > most * 0.5, do: "warn"
  defp limit_kind(_limit), do: nil

  defp streams(streams) when streams == %{}, do: "–"
  defp streams(streams), do: Enum.map_join(streams, ", ", fn {name, state} -> "#{name}: #{stream(state)}" end)

  defp stream(state) when is_atom(state) or is_binary(state), do: "#{state}"
  defp stream(other), do: inspect(other, limit: 5, printable_limit: 80)
end
