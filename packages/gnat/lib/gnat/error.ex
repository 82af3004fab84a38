defmodule Gnat.Error do
  @moduledoc """
  An error as a value that can be matched (`reason`) and read (`Exception.message/1`).

  | `reason` | when |
  |---|---|
  | `:not_connected` | there is no connection process behind this name or pid |
  | `:closed` | the server or the network closed the connection |
  | `:unresponsive` | the server sent nothing, not even the answer to a PING |
  | `:timeout` | no answer within the time allowed |
  | `{:connect, posix}` | the TCP connection could not be made |
  | `{:transport, posix}` | reading from or writing to the connection failed |
  | `{:tls, reason}` | the TLS handshake failed |
  | `:tls_not_offered` | TLS is required and the server has none |
  | `{:auth, text}` | the server refused the credentials |
  | `{:credentials, text}` | the seed, the token or the credentials file cannot be used |
  | `{:server, text}` | another error reported by the server |
  | `{:protocol, text}` | the peer sent something that is not the NATS protocol |
  | `{:payload_too_large, bytes, max}` | the server takes no message of that size |
  | `{:invalid_subject, subject}` | a subject, queue group or reply address that cannot be sent |
  | `{:invalid_header, name}` | a header that cannot be sent |
  | `:headers_not_supported` | the server is too old for headers |
  | `{:settings, text}` | the connection settings are wrong |
  """

  @type reason ::
          :not_connected
          | :closed
          | :unresponsive
          | :timeout
          | :tls_not_offered
          | :headers_not_supported
          | {:connect | :transport | :tls, term()}
          | {:auth | :credentials | :server | :protocol | :settings, String.t()}
          | {:payload_too_large, non_neg_integer(), non_neg_integer()}
          | {:invalid_subject | :invalid_header, term()}

  @type t :: %__MODULE__{reason: reason()}

  defexception [:reason]

  @doc "Wraps a reason."
  @spec new(reason()) :: t()
  def new(reason), do: %__MODULE__{reason: reason}

  @doc "The error as one line for a person."
  @impl Exception
  def message(%__MODULE__{reason: reason}), do: text(reason)

  defp text(:not_connected), do: "not connected to a NATS server"
  defp text(:closed), do: "the NATS server closed the connection"
  defp text(:unresponsive), do: "the NATS server does not answer to PING"
  defp text(:timeout), do: "no answer in time"
  defp text(:tls_not_offered), do: "TLS is required (tls: true) but the NATS server does not offer it"
  defp text(:headers_not_supported), do: "the NATS server does not support headers"
  defp text({:connect, reason}), do: "cannot connect to the NATS server: #{posix(reason)}"
  defp text({:transport, reason}), do: "the connection to the NATS server failed: #{posix(reason)}"
  defp text({:tls, reason}), do: "TLS with the NATS server failed: #{tls(reason)}"
  defp text({:auth, text}), do: "the NATS server refused the credentials: #{text}"
  defp text({:credentials, text}), do: "the NATS credentials cannot be used: #{text}"
  defp text({:server, text}), do: "the NATS server reports: #{text}"
  defp text({:protocol, text}), do: "this is not the NATS protocol: #{text}"
  defp text({:settings, text}), do: "wrong NATS connection settings: #{text}"

  defp text({:payload_too_large, bytes, max}) do
    "the message has #{bytes} bytes, the NATS server takes #{max} at most"
  end

  defp text({:invalid_subject, subject}) do
    "not a NATS subject: #{inspect(subject)} (no spaces or control characters, 1 to 1024 bytes)"
  end

  defp text({:invalid_header, header}) do
    "not a NATS header: #{inspect(header)} (a name of visible characters without colon, a value without line breaks)"
  end

  defp posix(reason) when is_atom(reason) do
    case :inet.format_error(reason) do
      ~c"unknown POSIX error" ++ _ -> Atom.to_string(reason)
      text -> "#{text} (#{reason})"
    end
  end

  defp posix(reason), do: tls(reason)

  defp tls({:tls_alert, {_alert, text}}), do: text |> to_string() |> String.replace(~r/\s+/, " ")
  defp tls({:options, _} = reason), do: "bad option #{inspect(reason)}"
  defp tls(reason) when is_atom(reason), do: Atom.to_string(reason)
  defp tls(reason), do: inspect(reason)
end
