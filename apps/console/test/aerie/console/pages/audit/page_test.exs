defmodule Aerie.Console.Pages.Audit.PageTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Control.Policy.Audit
  alias Aerie.HTTPClient

  @moduletag :tmp_dir
  @moduletag :capture_log

  setup %{tmp_dir: dir} do
    [console: console] = start_console()
    start_supervised!({Audit, gateway: console.gateway, dir: Path.join(dir, "audit"), max_bytes: 8_000_000})
    {:ok, console: console, dir: Path.join(dir, "audit")}
  end

  defp write(console, entries),
    do: for(entry <- entries, do: {:ok, _n} = Audit.append(console.gateway, entry))

  defp decision(decision, command, more \\ %{}),
    do:
      Map.merge(
        %{
          "type" => "decision",
          "decision" => decision,
          "command" => command,
          "source" => "ann",
          "vehicle" => "VID-001"
        },
        more
      )

  defp open(console, role \\ :operator) do
    {:ok, view, _html} = live(conn(console, role), "/audit")
    eventually(fn -> has_element?(view, "#records") end)
    view
  end

  test "viewers have no access", %{console: console} do
    assert {:error, {:redirect, %{to: "/"}}} = live(conn(console, :viewer), "/audit")
  end

  test "records, newest first, and new ones as they come", %{console: console} do
    write(console, [
      decision("allow", "arm"),
      decision("deny", "goto", %{
        "reason" => "outside the fence",
        "rule" => "geofence",
        "params" => %{"lat" => 47.5, "lon" => 8.5, "altitude" => 20.0},
        "digest" => String.duplicate("ab", 32)
      }),
      %{
        "type" => "result",
        "vehicle" => "VID-001",
        "command" => "arm",
        "source" => "ann",
        "result" => "completed"
      }
    ])

    view = open(console)
    assert has_element?(view, "#records .badge.bad", "Not allowed")
    assert has_element?(view, "#records .badge.ok", "Completed")
    assert has_element?(view, "#records td", "47.50000, 8.50000 at 20")
    # What only programs compare is in the details.
    assert has_element?(view, "#records details dd", String.duplicate("ab", 32))
    refute has_element?(view, "#records td[data-label=What]", "abab")
    assert has_element?(view, "#records td", "outside the fence")
    assert render(view) =~ "rule geofence"
    write(console, [decision("allow", "land")])
    eventually(fn -> has_element?(view, "#records td[data-label=What]", "Land") end)
  end

  test "filter and pages", %{console: console} do
    write(console, for(n <- 1..120, do: decision(if(rem(n, 2) == 0, do: "allow", else: "deny"), "c#{n}")))
    view = open(console)
    assert has_element?(view, "#records td[data-label=What]", "C120")
    refute has_element?(view, "button", "Newest")
    view |> element("button", "Older") |> render_click()

    eventually(fn ->
      has_element?(view, "#records td[data-label=What]", "C70") and
        not has_element?(view, "#records td[data-label=What]", "C120")
    end)

    view |> element("button", "Newest") |> render_click()
    eventually(fn -> has_element?(view, "#records td[data-label=What]", "C120") end)
    view |> element("#audit-filter") |> render_change(%{"text" => "C99"})

    eventually(fn ->
      has_element?(view, "#records td[data-label=What]", "C99") and
        not has_element?(view, "#records td[data-label=What]", "C120")
    end)

    view |> element("#audit-filter") |> render_change(%{"text" => "", "decision" => "allow"})

    eventually(fn ->
      has_element?(view, "#records td[data-label=What]", "C120") and
        not has_element?(view, "#records td[data-label=What]", "C119")
    end)

    view |> element("#audit-filter") |> render_change(%{"text" => "nowhere"})
    eventually(fn -> render(view) =~ "No record matches" end)
  end

  test "verified: whole, or what was changed", %{console: console, dir: dir} do
    write(console, [decision("allow", "arm"), decision("allow", "land")])
    view = open(console)
    view |> element("button", "Verify") |> render_click()
    eventually(fn -> has_element?(view, "#audit-report", "The log is intact") end)
    [file] = Path.wildcard(Path.join(dir, "*.jsonl"))
    File.write!(file, file |> File.read!() |> String.replace(~s("arm"), ~s("hug")))
    view |> element("button", "Verify") |> render_click()
    eventually(fn -> has_element?(view, "#audit-report.bad", "was changed") end)
  end

  test "a log that does not run says so", %{console: console} do
    write(console, [decision("allow", "arm")])
    view = open(console)
    stop_supervised!(Audit)
    eventually(fn -> has_element?(view, ".state.error", "does not run") end)
  end

  test "the export is for admins, and the whole log", %{console: console} do
    write(console, [decision("allow", "arm")])
    refute has_element?(open(console), "a", "Export")
    assert has_element?(open(console, :admin), "a[href='/download/audit']", "Export")
    get = fn jar -> HTTPClient.get(console, "/download/audit", jar) end
    jar = &HTTPClient.sign_in(console, "#{&1}", password(&1)).jar
    assert %{status: 200, body: body, headers: headers} = get.(jar.(:admin))
    assert headers["content-disposition"] =~ "audit.jsonl"
    assert body =~ ~s("command":"arm") and body =~ ~s("type":"opened")
    assert %{status: 403} = get.(jar.(:operator))
    assert %{status: 303, headers: %{"location" => "/sign-in"}} = get.(%{})
  end
end
