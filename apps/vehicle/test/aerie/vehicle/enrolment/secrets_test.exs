defmodule Aerie.Vehicle.Enrolment.SecretsTest do
  @moduledoc "S9: what is shown and logged of an enrolment has no key in it."
  use ExUnit.Case, async: true
  use Aerie.SigningCase

  import ExUnit.CaptureLog

  alias Aerie.Vehicle.Enrolment
  alias MavRouter.{Link, Signing}

  @moduletag :tmp_dir
  @key :binary.copy(<<0xA5, 0x5A>>, 16)

  setup c do
    gateway = start_signing(c.tmp_dir, key_file: key_file(c.tmp_dir, Base.encode16(@key)))
    {_id, _port} = add_link(gateway, "udpin:127.0.0.1:0?secure=true", id: "usb")
    {:ok, gateway: gateway}
  end

  defp refute_key(text), do: refute_key(text, @key)

  test "the events and the log of an enrolment", c do
    test = self()
    events = [:enrolled, :failed]

    :telemetry.attach_many(
      {c.gateway, :secrets},
      for(e <- events, do: [:aerie, :signing, e]),
      fn name, measurements, metadata, _ -> send(test, {:told, [name, measurements, metadata]}) end,
      nil
    )

    on_exit(fn -> :telemetry.detach({c.gateway, :secrets}) end)

    log =
      capture_log(fn ->
        assert {:error, %Aerie.Base.Error{} = error} =
                 Enrolment.enrol(c.gateway, {"main", 1},
                   link: "usb",
                   key: :generate,
                   timeout_ms: 50
                 )

        refute_key(Exception.message(error))
      end)

    assert log =~ "main/1"
    refute_key(log)
    assert_receive {:told, told}
    refute_key(shown(told))
    assert Link.get(c.gateway, "usb").signing.secure
  end

  test "without a key, and with one that cannot be read, it says so", c do
    none = start_parts(%{}, before: [{Signing.Supervisor, []}])

    assert {:error, %{reason: {:invalid, "no signing key is configured" <> _}}} =
             Enrolment.enrol(none, {"main", 1})

    path = key_file(c.tmp_dir)
    File.chmod!(path, 0o644)

    capture_log(fn ->
      gateway = start_signing(c.tmp_dir, key_file: path)
      assert {:error, %{reason: {:unavailable, text}}} = Enrolment.enrol(gateway, {"main", 1})
      assert text =~ "chmod 600"
    end)
  end
end
