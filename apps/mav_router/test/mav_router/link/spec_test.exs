defmodule MavRouter.Link.SpecTest do
  use ExUnit.Case, async: true

  alias MavRouter.Link.Spec

  doctest Spec

  describe "the forms of pymavlink" do
    test "UDP" do
      for prefix <- ["udpin:", "udp:"] do
        assert {:ok, spec} = Spec.parse(prefix <> "0.0.0.0:14550")
        assert %{kind: :udp_server, host: {0, 0, 0, 0}, port: 14_550, network: "main"} = spec
      end

      assert {:ok, %{kind: :udp_client, host: {10, 0, 0, 7}, port: 14_551, broadcast: false}} =
               Spec.parse("udpout:10.0.0.7:14551")

      assert {:ok, %{kind: :udp_client, broadcast: true}} = Spec.parse("udpbcast:192.168.1.255:14550")
    end

    test "TCP, names and IPv6" do
      assert {:ok, %{kind: :tcp_client, host: "sitl.local", port: 5760}} = Spec.parse("tcp:sitl.local:5760")
      assert {:ok, %{kind: :tcp_client, host: {0, 0, 0, 0, 0, 0, 0, 1}}} = Spec.parse("tcp:[::1]:5760")
      assert {:ok, %{kind: :tcp_server, host: {0, 0, 0, 0, 0, 0, 0, 0}}} = Spec.parse("tcpin:[::]:0")
    end

    test "WebSocket: a URL, with its own query and ours" do
      assert {:ok, %{kind: :websocket, host: {10, 0, 0, 7}, port: 80, path: "/", tls: false}} =
               Spec.parse("ws://10.0.0.7")

      assert {:ok, spec} =
               Spec.parse("wss://agent.example.org:8443/mavlink?token=a&network=north&x=1&ca=/etc/ca.pem")

      assert %{kind: :websocket, host: "agent.example.org", port: 8443, tls: true, network: "north"} = spec

      assert %{path: "/mavlink?token=a&x=1", ca: "/etc/ca.pem", id: "wss://agent.example.org:8443/mavlink"} =
               spec

      # The server's options may contain a password.
      assert spec.text == "wss://agent.example.org:8443/mavlink?…&network=north&ca=/etc/ca.pem"
      assert {:ok, %{host: {0, 0, 0, 0, 0, 0, 0, 1}, port: 443, path: "/?a"}} = Spec.parse("wss://[::1]?a")

      for {wrong, why} <- [
            {"ws://", "host and port are missing"},
            {"ws://:8765/", "host is missing"},
            {"ws://me:secret@host/", "a login is not possible"},
            {"ws://host:0/", "is not a port"},
            {"ws://host/a b", "its path has characters"},
            {"ws://host/#top", "no fragment"},
            {"ws://host/?ca=/etc/ca.pem", "is not an option"},
            {"ws://host/?network=a b", "is not a valid network"},
            {"http://host/", "another program's form"}
          ] do
        assert {:error, %Spec.Error{} = error} = Spec.parse(wrong)
        assert Exception.message(error) =~ why
      end
    end

    test "a server's empty host is every IPv4 address, its port 0 any free one" do
      assert {:ok, %{host: {0, 0, 0, 0}, port: 0}} = Spec.parse("udpin::0")
      assert {:error, _} = Spec.parse("udpout::14550")
      assert {:error, _} = Spec.parse("tcp:127.0.0.1:0")
    end

    test "serial" do
      assert {:ok, %{kind: :serial, device: "/dev/ttyACM0", baud: 115_200}} = Spec.parse("/dev/ttyACM0")
      assert {:ok, %{device: "/dev/serial/by-id/usb-A:b-if00"}} = Spec.parse("/dev/serial/by-id/usb-A:b-if00")
      assert {:ok, %{device: "/dev/ttyUSB0", baud: 57_600}} = Spec.parse("/dev/ttyUSB0,57600")
      assert {:ok, %{device: "ttyS1"}} = Spec.parse("ttyS1")
    end

    test "serial ports that are found by listening" do
      assert {:ok,
              %{
                kind: :serial,
                detect: :port,
                device: nil,
                bauds: nil,
                ports: [],
                only: false,
                id: "serial:auto"
              }} =
               Spec.parse("serial:auto")

      assert {:ok, %{detect: :port, ports: ["/dev/ttyAMA0", "ttyUSB1"], bauds: [57_600, 420_000], only: true}} =
               Spec.parse("serial:auto?ports=/dev/ttyAMA0,ttyUSB1&bauds=57600,420000&only=true&network=a")

      assert {:ok, %{detect: :baud, device: "/dev/ttyUSB0"}} = Spec.parse("serial:/dev/ttyUSB0")

      assert {:ok, %{detect: nil, device: "/dev/ttyUSB0", baud: 57_600}} =
               Spec.parse("serial:/dev/ttyUSB0,57600")

      assert Spec.place(Spec.parse!("serial:auto")) == "any serial port"

      for wrong <- [
            "serial:",
            "serial:x",
            "serial:/dev/ttyUSB0,fast",
            "serial:auto?bauds=",
            "serial:auto?bauds=57600,x",
            "serial:auto?ports=x",
            "serial:auto?only=maybe",
            "serial:///dev/ttyUSB0",
            "udpin::1?bauds=57600",
            "serial:auto?bauds=#{Enum.map_join(1..21, ",", fn _ -> "57600" end)}"
          ] do
        assert {:error, %Spec.Error{} = error} = Spec.parse(wrong)
        assert Exception.message(error) =~ "cannot use"
      end
    end

    test "MSP, at a serial port or over TCP" do
      assert {:ok, %Spec{kind: :msp, device: "/dev/ttyACM0", baud: 115_200, sysid: nil, client: nil}} =
               Spec.parse("msp:/dev/ttyACM0,115200")

      assert {:ok, %Spec{kind: :msp, host: {10, 0, 0, 7}, port: 5761, sysid: 7, network: "race"} = spec} =
               Spec.parse("msp:tcp:10.0.0.7:5761?sysid=7&network=race")

      assert Spec.place(spec) == "10.0.0.7:5761"
      assert %{share: {{127, 0, 0, 1}, 5771}} = Spec.parse!("msp:ttyUSB0,57600?share=5771")
      assert %{share: {{0, 0, 0, 0}, 5771}} = Spec.parse!("msp:ttyUSB0,57600?share=0.0.0.0:5771")
      assert Spec.place(Spec.parse!("msp:ttyUSB0,57600")) == "ttyUSB0"

      assert %{kind: :msp, detect: :port, ports: ["/dev/ttyAMA0"], only: true, sysid: 7, bauds: [57_600]} =
               auto = Spec.parse!("msp:auto?ports=/dev/ttyAMA0&only=true&sysid=7&bauds=57600")

      assert Spec.place(auto) == "any serial port"

      for {text, why} <- [
            {"msp:serial:auto", "is searched for by msp:auto"},
            {"msp:auto,57600", "nothing but options follows"},
            {"msp:tcp:10.0.0.7:5761?ports=ttyUSB0", "ports"},
            {"msp:/dev/ttyACM0?bauds=57600", "bauds"},
            {"msp:udpin:0.0.0.0:14550", "over serial ports and TCP"},
            {"msp:/dev/ttyACM0?sysid=255", "is not a MAVLink id"},
            {"msp:/dev/ttyACM0?sysid=7x", "is not a MAVLink id"},
            {"msp:/dev/ttyACM0?share=70000", "share=PORT"},
            {"msp:", "neither a known kind"}
          ] do
        assert {:error, error} = Spec.parse(text)
        assert Exception.message(error) =~ why
      end
    end

    test "replay" do
      assert {:ok, %{kind: :replay, file: "a b.tlog", speed: 1.0, loop: false}} =
               Spec.parse("replay:a b.tlog")

      assert {:ok, %{speed: :max, loop: true}} = Spec.parse("replay:x.tlog?speed=max&loop=true")
      assert {:ok, %{speed: 2.5}} = Spec.parse("replay:x.tlog?speed=2.5")
    end
  end

  test "identity and network" do
    assert %{id: "udpin:0.0.0.0:14550", network: "main"} = Spec.parse!("udpin:0.0.0.0:14550")
    assert %{id: "udpin::1", network: "a"} = Spec.parse!("udpin::1?network=a")
    assert %{id: "r1", network: "b"} = Spec.parse!("udpin::1?network=a&id=q", id: "r1", network: "b")
    assert %{options: %{max_peers: 3}} = Spec.parse!("udpin::1", options: [max_peers: 3])
  end

  test "places for people" do
    assert Spec.place(Spec.parse!("tcp:[::1]:5760")) == "[::1]:5760"
    assert Spec.place(Spec.parse!("tcp:a.b:1")) == "a.b:1"
    assert Spec.place(Spec.parse!("/dev/ttyACM0,9600")) == "/dev/ttyACM0"
    assert Spec.place(Spec.parse!("replay:/x/y.tlog")) == "y.tlog"
  end

  describe "an error says what is wrong, what was expected, and gives an example" do
    for {text, part} <- [
          {"", "neither a known kind of link nor a serial device"},
          {"udpin:", "host and port are missing"},
          {"udpin:0.0.0.0", "the port is missing"},
          {"udpin:0.0.0.0:", "the port is missing"},
          {"udpin:0.0.0.0:99999", "\"99999\" is not a port (0 to 65535)"},
          {"tcp:300.1.1.1:5760", "\"300.1.1.1\" is neither an address nor a name"},
          {"tcp:::1:5760", "an IPv6 address needs brackets"},
          {"tcp:[::g]:5760", "\"::g\" is not an IPv6 address"},
          {"tcp:[::1", "the port is missing"},
          {"/dev/ttyACM0,fast", "\"fast\" is not a valid baud rate"},
          {"/dev/ttyACM0,57600,8N1", "too many commas"},
          {"replay:", "the file is missing"},
          {"replay:x?speed=0", "\"0\" is not a valid speed"},
          {"replay:x?loop=maybe", "\"maybe\" is neither true nor false"},
          {"udpin::1?speed=2", "\"speed\" is not an option"},
          {"udpin::1?network=a b", "\"a b\" is not a valid network"},
          {"udp://:14540", "udp:// is another program's form"},
          {"127.0.0.1:14550", "write udpin:127.0.0.1:14550 to listen there"}
        ] do
      test inspect(text) do
        assert {:error, error} = Spec.parse(unquote(text))
        message = Exception.message(error)
        assert message =~ unquote(part)
        assert message =~ "expected "
        assert message =~ "for example "
      end
    end

    test "input that is not text" do
      assert {:error, %Spec.Error{}} = Spec.parse(nil)
      assert {:error, %Spec.Error{}} = Spec.parse(<<255, 0, 1>>)
      assert_raise Spec.Error, fn -> Spec.parse!("x") end
    end
  end

  test "any text is either a link or an error with a message" do
    property =
      :proper.forall(:proper_types.list(:proper_types.byte()), fn bytes ->
        for prefix <- ["", "udpin:", "tcp:", "replay:", "/dev/", "udpin:[", "tcp:h:1?"] do
          case Spec.parse(prefix <> IO.iodata_to_binary(bytes)) do
            {:ok, %Spec{}} -> true
            {:error, error} -> is_binary(Exception.message(error))
          end
        end
        |> Enum.all?()
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end

  # S9: what is refused is shown, and may have a password.
  test "an error has neither a login nor what was meant for the other end" do
    for text <- [
          "tcp://ann:hunter22@h:5760",
          "tcp:ann:hunter22@h:5760",
          "udpin:hunter22@0.0.0.0:1",
          "ws://ann:hunter22@h:80/x",
          "wss://ann:hunter22@h/x?token=hunter22",
          "ws://ann:hunter22/@h:80/",
          "ws://ann:b?hunter22@h",
          "msp:tcp:ann:hunter22@h:1",
          "rtsp://ann:hunter22@h/1",
          "wsserver:0.0.0.0:80?token=hunter22",
          "tcp:h:5760?password=hunter22",
          "tcp:h:0?key=hunter22&id=a",
          "ws://ann:hunter22@h\n"
        ] do
      assert {:error, error} = Spec.parse(text)
      refute Exception.message(error) =~ "hunter22", Exception.message(error)
    end

    # What helps remains.
    assert {:error, error} = Spec.parse("tcp:h?secure=true&token=x")
    assert Exception.message(error) =~ ~s(cannot use "tcp:h?secure=true&token=[hidden]" as a link)
  end
end
