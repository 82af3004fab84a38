defmodule Aerie.Console.RemoteTest do
  @moduledoc "Each page of a vehicle that only another gateway hears says what is there, and shows what this one knows."
  use Aerie.ConsoleCase, async: true

  alias Aerie.Fleet.Remote.Table

  @moduletag :capture_log
  @id "FAR-1"
  @via "gateway-FAR-1"

  setup do
    [console: console] = start_console()
    now = System.os_time(:microsecond)
    :ok = Table.configure(console.gateway, %{stale_us: 60_000_000, lost_us: 120_000_000})

    facts = %Aerie.Vehicle.Snapshot{
      network: "main",
      system_id: 1,
      autopilot: :ardupilot,
      vehicle_type: "copter",
      firmware: "4.6.0",
      status: :online,
      last_heard: now
    }

    :ok = Table.put_gateway(console.gateway, @id, @via, facts, now)

    for {group, data} <- [
          mode: %{mode: "GUIDED", armed: true, in_air: true, failsafe: false},
          position: %{lat: 47.3, lon: 8.5, alt_rel: 20.0},
          home: %{lat: 47.3, lon: 8.5, alt_msl: 488.0}
        ],
        do: Table.put(console.gateway, @id, group, %{data: data, at: now, time_boot_ms: nil, via: @via})

    %{console: console, now: now, facts: facts}
  end

  defp open(console, path, role \\ :operator) do
    {:ok, view, html} = live(conn(console, role), path)
    {view, html}
  end

  test "the vehicle's page: flying, commands and health as of any other, and where the rest is", %{
    console: console
  } do
    for section <- ["", "/commands", "/health"] do
      {view, html} = open(console, "/vehicles/#{@id}" <> section)
      assert html =~ "via #{@via}"
      assert has_element?(view, ".vehicle-mode", "GUIDED")
    end

    {_view, html} = open(console, "/vehicles/#{@id}")
    assert html =~ "The gateway #{@via} has its events."

    for {section, words} <- [
          {"events", "Its events are shown there"},
          {"charts", "its messages there"},
          {"links", "Its links and its clock are shown there"}
        ] do
      {view, html} = open(console, "/vehicles/#{@id}/#{section}")
      assert has_element?(view, "[data-elsewhere=#{@via}]", words)
      refute html =~ "No link hears this vehicle"
      refute html =~ "No events yet"
    end
  end

  test "messages of a vehicle here that has the same system id are not its own",
       %{console: console} = context do
    put_link(console, "radio")
    put_vehicle(console, "NEAR-1", [], %{key: {"main", 1}, system_id: 1})
    {near, _html} = open(console, "/vehicles/NEAR-1/charts")
    {far, _html} = open(console, "/vehicles/#{@id}/charts")
    bytes = MavCodec.encode(%MavCodec.Messages.Attitude{roll: 0.5}, system: 1, component: 1)
    {frames, _parser} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, context.now)
    MavRouter.Recorder.link_frames(console.gateway, "radio", frames)

    offered? = fn view ->
      send(view.pid, :refresh)
      has_element?(view, "#chart-message option", "ATTITUDE")
    end

    eventually(fn -> offered?.(near) end)
    refute offered?.(far)
  end

  test "parameters and plan: it can be chosen; the shadow leads back to it", %{console: console} do
    {view, _html} = open(console, "/params?vehicle=#{@id}")
    assert has_element?(view, "[data-elsewhere=#{@via}]", "Descriptions and setting parameters from a file")
    assert has_element?(view, "#params-vehicle-choice option[selected]", @id)
    # Without NATS that gateway cannot be asked, and the page says so.
    eventually(fn -> render(view) =~ "The parameters could not be read" end)

    {view, _html} = open(console, "/plan?vehicle=#{@id}")
    assert has_element?(view, "#plan-vehicle-field option[selected]", @id)
    view |> element("button[phx-click=home]") |> render_click()
    refute render(view) =~ "the vehicle has not reported its home"

    {view, _html} = open(console, "/vehicles/#{@id}/shadow")
    assert has_element?(view, "a", "To the vehicle")
  end

  test "an emergency, and silence while armed, are also alarms here", %{console: console} = context do
    now = context.now + 1

    Table.put(console.gateway, @id, :mode, %{
      data: %{mode: "RTL", armed: true, in_air: true, failsafe: true},
      at: now,
      time_boot_ms: nil,
      via: @via
    })

    {view, _html} = open(console, "/alarms")
    eventually(fn -> has_element?(view, "#alarms .alarm-row", "Vehicle reports an emergency") end)
    Table.put_gateway(console.gateway, @id, @via, %{context.facts | status: :lost}, now)
    eventually(fn -> has_element?(view, "#alarms .alarm-row", "Lost contact while armed") end)
  end
end
