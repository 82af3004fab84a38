defmodule MavRouter.Link.Reason do
  @moduledoc "Faults of a link in words: `connection refused by 127.0.0.1:5760`."

  alias MavRouter.Link.Serial.Finding
  alias MavRouter.Link.Spec

  @doc "A reason as a text for people. An unknown one is inspected."
  @spec format(term, Spec.t()) :: String.t()
  def format(reason, spec), do: explain(reason, spec) || reason_text(reason, spec)

  defp explain(reason, %{transport: transport} = spec) do
    if function_exported?(transport, :explain, 2), do: transport.explain(reason, spec)
  end

  defp reason_text(text, _spec) when is_binary(text), do: text
  defp reason_text({:undetected, findings}, _spec), do: Finding.summary(findings)
  defp reason_text(:econnrefused, spec), do: "connection refused by #{Spec.place(spec)}"
  defp reason_text(:closed, spec), do: "connection closed by #{Spec.place(spec)}"
  defp reason_text(:econnreset, spec), do: "connection reset by #{Spec.place(spec)}"

  defp reason_text(reason, spec) when reason in [:timeout, :etimedout],
    do: "no answer from #{Spec.place(spec)}"

  defp reason_text(:ehostunreach, spec), do: "no route to the host of #{Spec.place(spec)}"
  defp reason_text(:enetunreach, spec), do: "no route to the network of #{Spec.place(spec)}"
  defp reason_text(:enetdown, spec), do: "the network of #{Spec.place(spec)} is down"
  defp reason_text(:eaddrnotavail, spec), do: "#{Spec.place(spec)} is not an address of this machine"
  defp reason_text({:in_use, owner}, spec), do: "#{Spec.place(spec)} is in use by #{owner}"
  defp reason_text(:eacces, spec), do: "no permission for #{Spec.place(spec)}#{permission_hint(spec)}"
  defp reason_text(:eperm, spec), do: "no permission for #{Spec.place(spec)}#{permission_hint(spec)}"
  defp reason_text(:enoent, spec), do: "there is no #{Spec.place(spec)}"
  defp reason_text(:ebusy, spec), do: "#{Spec.place(spec)} is in use by another program"
  defp reason_text(:eio, spec), do: "#{Spec.place(spec)} was unplugged"
  defp reason_text(:nxdomain, spec), do: "the name of #{Spec.place(spec)} cannot be resolved"
  defp reason_text(:emfile, _spec), do: "this program has too many open files (see ulimit -n)"
  defp reason_text({:shutdown, reason}, spec), do: format(reason, spec)

  defp reason_text(reason, spec) when is_atom(reason) do
    case :inet.format_error(reason) do
      ~c"unknown POSIX error" ++ _ -> "#{reason} on #{Spec.place(spec)}"
      words -> "#{words} on #{Spec.place(spec)}"
    end
  end

  defp reason_text(reason, spec),
    do: "#{Spec.place(spec)} failed: #{inspect(reason, limit: 10, printable_limit: 200)}"

  @doc "A wait in words: `now`, `3.2 s`."
  @spec wait(non_neg_integer) :: String.t()
  def wait(ms) when ms < 50, do: "now"
  def wait(ms), do: "in #{:erlang.float_to_binary(ms / 1000, decimals: 1)} s"

  defp permission_hint(%{port: port}) when is_integer(port) and port < 1024,
    do: " (ports below 1024 need root)"

  defp permission_hint(_spec), do: ""
end
