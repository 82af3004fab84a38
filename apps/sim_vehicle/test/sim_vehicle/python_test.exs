defmodule SimVehicle.PythonTest do
  @moduledoc """
  A real ground station's library against the simulated vehicles, over each transport.
  """

  use ExUnit.Case, async: true

  alias SimVehicle.{Peer, PythonPeer}

  @moduletag :python

  # A port that was free a moment ago: pymavlink wants to open it itself.
  defp free_port do
    peer = Peer.udp()
    port = Peer.port(peer)
    Peer.close(peer)
    port
  end

  # Its ten seconds on the ground until it disarms are one of ours.
  @stays_armed %{ardupilot: %{"DISARM_DELAY" => 0}, px4: %{"COM_DISARM_PRFLT" => 0}}

  defp fly(firmware, link, address) do
    options = [firmware: firmware, link: link, system: 7, speed: 10, ready_s: 5.0]
    sim = start_supervised!({SimVehicle, [params: @stays_armed[firmware]] ++ options})
    {findings, code, output} = PythonPeer.run("gcs.py", [address.(sim), "#{firmware}"])
    assert code == 0, output
    findings
  end

  for {transport, link} <- [udp: "udpout", tcp: "tcpin"] do
    test "ArduCopter over #{transport}: parameters, mission, arm, take off, go, land" do
      findings =
        case unquote(link) do
          "udpout" ->
            port = free_port()
            fly(:ardupilot, "udpout:127.0.0.1:#{port}", fn _sim -> "udpin:127.0.0.1:#{port}" end)

          "tcpin" ->
            fly(:ardupilot, "tcpin:127.0.0.1:0", fn sim -> "tcp:127.0.0.1:#{SimVehicle.port(sim)}" end)
        end

      assert %{
               "system" => "7",
               "RTL_ALT" => "1500.0",
               "takeoff_refused" => "[4]",
               "unknown" => "[3]",
               "upload" => "0",
               "mission" => "[(0, 16), (1, 22), (2, 16), (3, 20)]",
               "same" => "True",
               "arm" => "[0]",
               "takeoff" => "[0]",
               "goto" => "reached",
               "disarm_in_air" => "[4]",
               "landed" => "disarmed",
               # pymavlink counts the boot text in front of the first frame on TCP.
               "bad" => _bad
             } = findings
    end
  end

  test "PX4 over UDP: parameters, double acknowledgements, texts, arm, take off, land" do
    findings = fly(:px4, "udpin:127.0.0.1:0", fn sim -> "udpout:127.0.0.1:#{SimVehicle.port(sim)}" end)

    assert %{
             "hash" => "True",
             "unknown" => "[3]",
             "offboard_while_disarmed" => "[0, 0]",
             "arm" => "[0]",
             "armed_text" => "'Armed by external command\\t'",
             "takeoff" => "[0]",
             "offboard_refused" => "[0, 1]",
             "disarm_in_air" => "[1]",
             "landed" => "disarmed",
             "bad" => "0"
           } = findings
  end
end
