defmodule Gnat.ErrorTest do
  use ExUnit.Case, async: true

  alias Gnat.Error

  test "every reason reads as a sentence and not as a term" do
    for reason <- [
          :not_connected,
          :closed,
          :unresponsive,
          :timeout,
          :tls_not_offered,
          :headers_not_supported,
          {:connect, :econnrefused},
          {:connect, :nxdomain},
          {:connect, :no_such_reason},
          {:transport, :etimedout},
          {:tls, {:tls_alert, {:unknown_ca, ~c"TLS client: In state wait_cert\n unknown"}}},
          {:tls, :closed},
          {:auth, "Authorization Violation"},
          {:credentials, "no seed"},
          {:server, "Slow Consumer"},
          {:protocol, "unknown command"},
          {:settings, "unknown key"},
          {:payload_too_large, 11, 10}
        ] do
      text = Exception.message(Error.new(reason))
      assert text =~ ~r/\A\w[^{}\n]+\z/
      refute text == inspect(reason)
    end
  end

  test "values that were refused are shown as they were" do
    assert Exception.message(Error.new({:invalid_subject, "a b"})) =~ ~s("a b")
    assert Exception.message(Error.new({:invalid_header, {"a", "b\n"}})) =~ ~S("b\n")
  end
end
