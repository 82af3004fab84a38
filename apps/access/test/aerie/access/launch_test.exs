defmodule Aerie.Access.LaunchTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]
  import ExUnit.CaptureLog

  alias Aerie.Access.Launch

  @moduletag :tmp_dir

  setup %{tmp_dir: dir}, do: %{gateway: make_ref(), path: Path.join([dir, "console", "url"])}

  test "the printed address has the token, and no other text is it", %{gateway: gateway, path: path} do
    assert Launch.url(gateway, "http://127.0.0.1:4000") == nil
    refute Launch.valid?(gateway, "")
    start_supervised!({Launch, gateway: gateway, file: path})
    "http://127.0.0.1:4000/launch?token=" <> token = Launch.url(gateway, "http://127.0.0.1:4000")
    assert Launch.valid?(gateway, token)
    other = String.duplicate("x", byte_size(token))
    for wrong <- [other, token <> "x", "", nil, %{}, ["x"]], do: refute(Launch.valid?(gateway, wrong))
  end

  test "the file has an address that this machine reaches, for its owner only, and goes with the gateway",
       c do
    for {address, host} <- [
          {{0, 0, 0, 0}, "127.0.0.1"},
          {{0, 0, 0, 0, 0, 0, 0, 0}, "[::1]"},
          {{0xFD00, 0, 0, 0, 0, 0, 0, 1}, "[fd00::1]"},
          {{192, 0, 2, 7}, "192.0.2.7"}
        ] do
      start_supervised!({Launch, gateway: c.gateway, file: c.path})
      :ok = Launch.write(c.gateway, address, 4000)
      url = Launch.url(c.gateway, "http://#{host}:4000")
      eventually(fn -> File.read(c.path) == {:ok, url <> "\n"} end)
      assert Bitwise.band(File.stat!(c.path).mode, 0o777) == 0o600
      stop_supervised!(Launch)
      refute File.exists?(c.path)
    end
  end

  test "a file that cannot be written is a warning, and the token is in no crash report", c do
    pid = start_supervised!({Launch, gateway: c.gateway, file: c.path})
    File.write!(Path.dirname(c.path), "a file in its place")

    assert capture_log(fn ->
             Launch.write(c.gateway, {127, 0, 0, 1}, 4000)
             assert {:status, _pid, _module, _status} = status = :sys.get_status(pid)
             "http://x/launch?token=" <> token = Launch.url(c.gateway, "http://x")
             refute inspect(status, limit: :infinity) =~ token
           end) =~ "console/url"
  end
end
