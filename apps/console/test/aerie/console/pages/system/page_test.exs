defmodule Aerie.Console.Pages.System.PageTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Console.Pages.System.Figures

  @moduletag :capture_log

  setup do: {:ok, start_console()}

  test "the figures of the gateway, NATS, and versions", %{console: console} do
    {:ok, view, _html} = live(conn(console, :viewer), "/system")
    html = render(view)

    # Each value stands behind its name.
    for name <- ["Up", "Heartbeat", "Processor time", "Memory", "Nearest limit", "Elixir", "OTP"],
        do: assert(html =~ ~r{<dt>#{name}</dt>\s*<dd>[^<]})

    assert html =~ System.version() and html =~ "The bridge is not running."
  end

  test "the page goes on measuring, processor time from the second time on", %{console: console} do
    {:ok, view, _html} = live(conn(console, :viewer), "/system")
    assert render(view) =~ "measuring…"
    eventually(fn -> render(view) =~ "% of one core" end)
  end

  test "the limit that is nearest is named", %{console: console} do
    assert %{limit: {name, used, most}, cpu: nil} = Figures.of(console.gateway, nil)
    assert name in ["processes", "ports", "atoms", "ETS tables"] and used <= most

    for {used_by, most_of} <- [process_count: :process_limit, port_count: :port_limit],
        do: assert(used / most >= :erlang.system_info(used_by) / :erlang.system_info(most_of))
  end
end
