defmodule FleetWeb.Console.System.Page do
  @moduledoc "The page of the gateway as a program: its supervision tree with restarts, the busiest processes, memory, run queues, NATS, versions."
  use FleetWeb.Console, {:page, events: [viewer: ~w(sort)], costly: ~w(sort)}

  import FleetWeb.Console.System.Parts

  alias FleetWeb.Console.System.Sampler
  alias FleetWeb.Console.UI.Age

  @sorts %{"memory" => :memory, "reductions" => :reductions, "queue" => :queue}
  @parts [{"overview", "Overview"}, {"tree", "Supervision"}, {"processes", "Processes"}]
  # The sampler does not measure more often.
  @every 2

  @impl Phoenix.LiveView
  def mount(_params, _session, socket) do
    {:ok,
     socket
     |> assign(page_title: "System", sort: :memory, part: "overview", turn: 0, sample: nil)
     |> subscribe([])}
  end

  @impl Phoenix.LiveView
  def handle_params(params, _uri, socket) do
    part = if List.keymember?(@parts, params["part"], 0), do: params["part"], else: "overview"
    {:noreply, socket |> assign(:part, part) |> load()}
  end

  @impl Phoenix.LiveView
  def handle_event("sort", %{"by" => by}, socket) when is_map_key(@sorts, by),
    do: {:noreply, assign(socket, :sort, @sorts[by])}

  def handle_event("sort", _other, socket), do: {:noreply, socket}

  @impl Phoenix.LiveView
  def handle_info(:refresh, %{assigns: %{turn: turn}} = socket) do
    socket = assign(socket, :turn, rem(turn + 1, @every))
    {:noreply, if(turn == 0, do: load(socket), else: socket)}
  end

  defp load(%{assigns: %{gateway: gateway, sample: last}} = socket) do
    sample = if connected?(socket), do: Sampler.sample(gateway)

    assign(socket,
      sample: sample || last,
      failed?: connected?(socket) and sample == nil,
      now: System.os_time(:microsecond)
    )
  end

  @impl Phoenix.LiveView
  def render(assigns) do
    ~H"""
    <h1 class="page-title">System</h1>
    <.tabs label="Parts of the system">
      <:tab :for={{id, label} <- parts()} patch={"/system?part=#{id}"} current={@part == id}>{label}</:tab>
    </.tabs>
    <.loading :if={@sample == nil && !@failed?} />
    <.error :if={@sample == nil && @failed?} title="No measurement">Next try in two seconds.</.error>
    <.stale :if={@sample && @failed?}>Measured {Age.text(@now - @sample.at)} ago; the gateway is too busy to measure again.</.stale>
    <div :if={@sample && @part == "overview"} id="system-overview" class="cards">
      <.machine facts={@sample.facts} />
      <.memory facts={@sample.facts} />
      <.limits facts={@sample.facts} />
      <.nats facts={@sample.facts} />
      <.versions facts={@sample.facts} />
    </div>
    <section :if={@sample && @part == "tree"} id="system-tree" aria-label="Supervision tree">
      <p class="muted">Restarts since the console started. At most fifty children are shown.</p>
      <.empty :if={@sample.tree == nil} icon="system" title="The gateway is not running" />
      <ul :if={@sample.tree} class="tree" role="tree"><.tree_node :for={node <- @sample.tree.children} node={node} now={@now} depth={1} /></ul>
    </section>
    <section :if={@sample && @part == "processes"} id="system-processes">
      <p class="muted">The busiest of {@sample.top.looked_at} processes.</p>
      <.data_table id="processes" label="Processes" rows={Map.fetch!(@sample.top, @sort)} row_id={&row_id/1} sort={{to_string(@sort), :desc}}>
        <:col :let={row} label="Process" class="grow"><span class="mono">{row.name}</span></:col>
        <:col :let={row} label="Memory" sort="memory" number>{bytes(row.memory)}</:col>
        <:col :let={row} label="Reductions/s" sort="reductions" number>{reductions(row.reductions)}</:col>
        <:col :let={row} label="Queue" sort="queue" number>{row.queue}</:col>
      </.data_table>
      <.empty :if={Map.fetch!(@sample.top, @sort) == []} icon="check" title="None">No process has messages waiting.</.empty>
    </section>
    """
  end

  defp parts, do: @parts

  defp row_id(%{pid: pid}),
    do:
      "process-" <>
        (pid
         |> :erlang.pid_to_list()
         |> to_string()
         |> String.replace(~r/[<>]/, "")
         |> String.replace(".", "-"))

  defp reductions(nil), do: "–"
  defp reductions(n), do: "#{round(n)}"
end
