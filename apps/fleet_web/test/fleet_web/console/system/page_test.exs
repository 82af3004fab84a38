defmodule FleetWeb.Console.System.PageTest do
  use FleetWeb.ConsoleCase, async: true

  alias Aerie.Base.Names
  alias FleetWeb.Console.System.{BusiestProcesses, Sampler}

  @moduletag :capture_log

  setup do: {:ok, start_console()}

  defp open(console, part) do
    {:ok, view, _html} = live(conn(console, :viewer), "/system?part=#{part}")
    view
  end

  test "the figures of the virtual machine, and NATS", %{console: console} do
    html = console |> open("overview") |> render()

    for word <- ["Virtual machine", "Run queue", "processes", "binary", "Elixir", System.version(), "NATS"],
        do: assert(html =~ word)

    # Each value stands behind its name.
    for name <- ["processes", "ETS tables", "Cowboy"], do: assert(html =~ ~r{<dt>#{name}</dt>\s*<dd>})
    assert html =~ "The bridge is not running."
  end

  test "before the page is connected nothing is measured", %{console: console} do
    before =
      Names.whereis(console.gateway, :console_system)
      |> :sys.get_state(Aerie.Patience.ms())
      |> Map.fetch!(:measured)

    assert before == nil
    {:ok, _view, html} = live(conn(console, :viewer), "/system")
    assert html =~ "System"
  end

  test "the supervision tree shows a process that died and came back, with its reason", %{console: console} do
    view = open(console, "tree")
    html = render(view)
    for name <- ["store", "router", "recorder", "console"], do: assert(html =~ name)
    refute html =~ "restarted"
    eventually(fn -> restart(console, view) end)
  end

  # Whoever dies before the sampler knows it is not counted.
  defp restart(console, view) do
    meter = Names.whereis(console.gateway, :router_meter)
    if meter, do: Process.exit(meter, :kill)
    has_element?(view, ".badge.bad", "restart") and render(view) =~ "killed"
  end

  test "processes by memory, work and waiting messages", %{console: console} do
    view = open(console, "processes")
    assert has_element?(view, "#processes tbody tr")
    assert has_element?(view, "th[aria-sort=descending]", "Memory")
    view |> element("button.sort", "Reductions") |> render_click()
    assert has_element?(view, "th[aria-sort=descending]", "Reductions")
    render_click(view, "sort", %{"by" => "nonsense"})
    assert has_element?(view, "th[aria-sort=descending]", "Reductions")
  end

  test "however many look, the processes are looked at once in two seconds", %{console: console} do
    # As long as a busy machine may take for twenty callers.
    sampler = Names.whereis(console.gateway, :console_system)
    :sys.replace_state(sampler, &%{&1 | fresh_ms: 600_000}, Aerie.Patience.ms())
    [first | rest] = for _viewer <- 1..20, do: Task.async(fn -> Sampler.sample(console.gateway) end)
    sample = Task.await(first, Aerie.Patience.ms())
    for task <- rest, do: assert(Task.await(task, Aerie.Patience.ms()) == sample)
  end

  test "when it No measurement, it says so, and what is shown is old", %{console: console} do
    view = open(console, "overview")
    sampler = Names.whereis(console.gateway, :console_system)
    ref = Process.monitor(sampler)
    :ok = Supervisor.terminate_child(Names.via(console.gateway, :console), Sampler)
    assert_receive {:DOWN, ^ref, :process, _pid, _reason}
    eventually(fn -> has_element?(view, ".notice.warn", "too busy to measure") end)
    assert console |> open("overview") |> render() =~ "No measurement"
  end

  test "the first look at the work of processes has nothing to compare with" do
    {top, totals} = BusiestProcesses.of(%{}, nil)
    assert [%{reductions: nil} | _] = top.reductions
    {top, _totals} = BusiestProcesses.of(totals, 1_000)
    assert [%{reductions: n} | _] = top.reductions
    assert is_number(n)
    assert top.looked_at > 20
  end
end
