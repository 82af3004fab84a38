defmodule Aerie.Fleet.DiagnosisTest do
  @moduledoc "Each condition by its real cause: simulated vehicles, cables with another baud rate, sockets, disks and servers that fail."
  use ExUnit.Case, async: true
  use Aerie.VehicleCase

  alias Aerie.Base.Store
  alias Aerie.Fleet.Diagnosis
  alias Aerie.SerialPeer
  alias MavRouter.Link
  alias Aerie.Fleet.Diagnosis.{Condition, Observations}

  @moduletag :capture_log

  setup do
    {:ok, gateway: start_parts(%{mavlink: %{system_id: 237, component_id: 191}})}
  end

  # Waits until the rules see it, half a minute after the present moment. `change` is what else has gone on in that time.
  defp noticed(gateway, name, change \\ & &1) do
    {_conditions, diagnosis} = Diagnosis.step(Diagnosis.new(), Observations.of(gateway))

    eventually(fn ->
      facts = gateway |> Observations.of() |> Map.update!(:mono, &(&1 + 30_000)) |> change.()
      {conditions, _diagnosis} = Diagnosis.step(diagnosis, facts)
      Enum.find(conditions, &(&1.name == name))
    end)
  end

  defp silence(facts), do: %{facts | now: facts.now + 30_000_000}
  defp longer(facts), do: %{facts | links: Enum.map(facts.links, &%{&1 | since: &1.since - 30_000_000})}

  defp socket do
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    socket
  end

  defp say(socket, port, bytes), do: :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, bytes)

  # Says something again and again, until the test ends.
  defp repeat(port, bytes, every \\ 50) do
    start_supervised!(
      {Task,
       fn ->
         socket = socket()

         Stream.iterate(0, &(&1 + 1))
         |> Enum.each(fn n ->
           say(socket, port, bytes.(n))
           Process.sleep(every)
         end)
       end},
      id: make_ref()
    )
  end

  defp online(gateway, id) do
    eventually(fn -> match?(%{status: :online}, Store.vehicle(gateway, id)) end)
    id
  end

  defp sim(port, options),
    do: start_supervised!({SimVehicle, [link: "udpout:127.0.0.1:#{port}"] ++ options}, id: make_ref())

  describe "serial ports" do
    @describetag :pty

    test "another baud rate than the vehicle's", c do
      peer = SerialPeer.start(baud: 57_600, every: 50, says: &(heartbeat(1) <> attitude(1, &1)))
      path = SerialPeer.path(peer)
      {id, _port} = add_link(c.gateway, "#{path},115200", options: [garbled_ms: 500])
      assert %{severity: :error, subject: {:link, ^id}} = condition = noticed(c.gateway, :wrong_baud)
      assert condition.title =~ path
      assert [evidence] = condition.evidence
      assert evidence =~ "at 115200 baud"
      assert condition.mend =~ "serial:#{path}"
      SerialPeer.change(peer, baud: 115_200)
      eventually(fn -> :wrong_baud not in names(c.gateway) end)
    end

    test "a GPS receiver in place of a vehicle", c do
      dev = Path.join(System.tmp_dir!(), "aerie-diagnosis-#{System.unique_integer([:positive])}")
      File.mkdir_p!(dev)
      on_exit(fn -> File.rm_rf(dev) end)
      line = "$GPGLL,5057.970,N,00146.110,E,142451,A*27\r\n"
      SerialPeer.start(baud: 9_600, every: 100, says: fn _ -> line end, name_in: {dev, "ttyUSB0"})
      add_link(c.gateway, "serial:auto", options: [serial_dev: dev, silent_ms: 500, garbled_ms: 500])
      assert %{severity: :error, evidence: [evidence], mend: mend} = noticed(c.gateway, :wrong_protocol)
      assert evidence =~ "NMEA"
      assert mend =~ "GPS receiver"
    end
  end

  defp names(gateway) do
    {conditions, _diagnosis} = Diagnosis.step(Diagnosis.new(), Observations.of(gateway))
    Enum.map(conditions, & &1.name)
  end

  test "two simulated vehicles with one id", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "radio")
    sim(port, system: 7, ready_s: 0)
    sim(port, system: 7, ready_s: 0, home: {47.0, 8.0, 500.0}, seed: 2)

    assert %{severity: :error, title: "two vehicles use system id 7 (" <> _name} =
             condition = noticed(c.gateway, :two_vehicles_one_id)

    assert condition.evidence |> Enum.join() =~ "alternates"
  end

  test "a simulated vehicle that has nothing wrong has no condition", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "radio")
    sim(port, system: 7, ready_s: 0)

    eventually(fn ->
      match?(%{clock: %{samples: n}, firmware: "" <> _} when n > 0, Store.vehicle(c.gateway, {"main", 7}))
    end)

    # A busy machine may lose datagrams or send slowly for a moment, which is told rightly, and passes.
    half_a_minute_later = fn ->
      {_conditions, diagnosis} = Diagnosis.step(Diagnosis.new(), Observations.of(c.gateway))
      later = Map.update!(Observations.of(c.gateway), :mono, &(&1 + 30_000))
      diagnosis |> Diagnosis.step(later) |> elem(0)
    end

    Aerie.Patience.eventually(fn -> half_a_minute_later.() == [] end, fn ->
      inspect(half_a_minute_later.())
    end)
  end

  test "a vehicle that is heard and hears nothing", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "radio")
    repeat(port, &(heartbeat(9) <> attitude(9, &1 * 50)))
    online(c.gateway, {"main", 9})
    assert %{severity: :error, evidence: [sent | _]} = noticed(c.gateway, :one_way_link)
    assert sent =~ ~r/[1-9]\d* frames sent by radio/
  end

  test "a vehicle that speaks MAVLink 1", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "radio")

    bytes =
      MavCodec.encode(%MavCodec.Messages.Heartbeat{type: 2, autopilot: 3, mavlink_version: 3},
        system: 9,
        version: 1
      )

    repeat(port, fn _n -> bytes end)
    online(c.gateway, {"main", 9})
    assert %{severity: :notice, mend: mend} = noticed(c.gateway, :mavlink1_only)
    assert mend =~ "SERIALn_PROTOCOL 2"
  end

  test "an autopilot with the gateway's own ids", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "radio")
    repeat(port, fn _n -> heartbeat(237, component: 191) end)
    assert %{severity: :error, subject: :gateway} = noticed(c.gateway, :own_ids_taken)
  end

  test "a hub, and a vehicle with its system id", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "radio")
    repeat(port, fn _n -> heartbeat(237) end)
    repeat(port, fn _n -> heartbeat(5) end)
    online(c.gateway, {"main", 237})
    assert %{severity: :warning, title: title} = noticed(c.gateway, :own_id_taken)
    assert title =~ "237"
  end

  test "our own frames come back: a loop of routers", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "radio")
    own = MavCodec.encode(%MavCodec.Messages.Heartbeat{type: 18, autopilot: 8}, system: 237, component: 191)
    repeat(port, fn _n -> heartbeat(5) <> own end)
    online(c.gateway, {"main", 5})
    assert %{severity: :warning, evidence: [evidence]} = noticed(c.gateway, :gateway_loop)
    assert evidence =~ "237/191"
  end

  test "bytes that are no MAVLink, over TCP", c do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    {:ok, port} = :inet.port(listener)

    start_supervised!(
      {Task,
       fn ->
         {:ok, socket} = :gen_tcp.accept(listener)

         Stream.repeatedly(fn -> :gen_tcp.send(socket, String.duplicate("HTTP/1.1 200 OK\r\n", 20)) end)
         |> Enum.each(fn _sent -> Process.sleep(20) end)
       end}
    )

    add_link(c.gateway, "tcp:127.0.0.1:#{port}", id: "web")
    eventually(fn -> match?(%{status: :up}, Link.get(c.gateway, "web")) end)
    assert %{severity: :error, evidence: [evidence]} = noticed(c.gateway, :wrong_protocol)
    assert evidence =~ "no MAVLink frame"
  end

  test "nobody listens where a link is to connect; nobody calls in", c do
    {:ok, listener} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(listener)
    :gen_tcp.close(listener)
    add_link(c.gateway, "tcp:127.0.0.1:#{port}", id: "away")
    assert %{subject: {:link, "away"}, evidence: [reason]} = noticed(c.gateway, :link_down)
    assert reason =~ "refused"
    add_link(c.gateway, "udpin:127.0.0.1:0", id: "quiet")
    assert %{severity: :notice, subject: {:link, "quiet"}} = noticed(c.gateway, :link_silent, &silence/1)
  end

  test "a radio whose vehicle is off", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "radio")
    radio = MavCodec.encode(%MavCodec.Messages.RadioStatus{rssi: 190}, system: 51, component: 68)
    repeat(port, fn _n -> radio end)
    eventually(fn -> Link.get(c.gateway, "radio").sources != %{} end)
    assert %{severity: :notice, evidence: [evidence]} = noticed(c.gateway, :no_vehicle, &longer/1)
    assert evidence =~ "51/68"
  end

  test "a cable that damages frames", c do
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "radio")
    <<good::binary-size(12), _byte, rest::binary>> = attitude(5, 1)
    repeat(port, fn _n -> heartbeat(5) <> good <> <<0xAA>> <> rest end, 10)
    online(c.gateway, {"main", 5})
    assert %{severity: :warning, title: title} = noticed(c.gateway, :noisy_link)
    assert title =~ "%"
  end

  test "NATS that is not there, and a gateway without NATS", c do
    assert :nats_unreachable not in names(c.gateway)
    {:ok, listener} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(listener)
    :gen_tcp.close(listener)
    dir = Path.join(System.tmp_dir!(), "aerie-diagnosis-#{System.unique_integer([:positive])}")
    on_exit(fn -> File.rm_rf(dir) end)

    gateway =
      Aerie.BridgeCase.start_bridge(
        Aerie.BridgeCase.config(dir, [{"nats.mode", "url"}, {"nats.url", ["nats://127.0.0.1:#{port}"]}])
      )

    assert %{severity: :error, subject: :gateway} = noticed(gateway, :nats_unreachable)
  end

  test "the server looks once for all who ask, and knows since when", c do
    start_supervised!({Diagnosis.Server, gateway: c.gateway, fresh_ms: 0})
    {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "radio")
    repeat(port, fn _n -> heartbeat(237, component: 191) end)
    of = fn -> Enum.find(Diagnosis.list(c.gateway), &(&1.name == :own_ids_taken)) end
    first = eventually(of)
    assert is_integer(first.since)
    assert eventually(of).since == first.since
    assert %{name: :own_ids_taken, subject: :gateway, since: "20" <> _} = Condition.plain(first)
    assert Diagnosis.list(make_ref()) == []
  end
end
