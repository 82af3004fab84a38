defmodule Aerie.Link.Reason do
  @moduledoc "Faults of a link in words: `connection refused by 127.0.0.1:5760`."

  alias Aerie.Link.Serial.Finding
  alias Aerie.Link.Spec

  @doc "Says what a reason means for a link. Every reason has words; an unheard-of one is shown as it is."
  @spec format(term, Spec.t()) :: String.t()
  def format(reason, spec)

  def format(text, _spec) when is_binary(text), do: text
  def format({:undetected, findings}, _spec), do: Finding.summary(findings)
  def format(:econnrefused, spec), do: "connection refused by #{Spec.place(spec)}"
  def format(:closed, spec), do: "connection closed by #{peer(spec)}"
  def format(:econnreset, spec), do: "connection reset by #{peer(spec)}"
  def format(reason, spec) when reason in [:timeout, :etimedout], do: "no answer from #{Spec.place(spec)}"
  def format(:ehostunreach, spec), do: "no way to the host of #{Spec.place(spec)}"
  def format(:enetunreach, spec), do: "no way to the network of #{Spec.place(spec)}"
  def format(:enetdown, spec), do: "the network of #{Spec.place(spec)} is down"
  def format(:eaddrnotavail, spec), do: "#{Spec.place(spec)} is no address of this machine"
  def format({:in_use, owner}, spec), do: "#{Spec.place(spec)} is in use by #{owner}"
  def format(:eacces, spec), do: "no permission for #{Spec.place(spec)}#{permission_hint(spec)}"
  def format(:eperm, spec), do: "no permission for #{Spec.place(spec)}#{permission_hint(spec)}"
  def format(:enoent, %{kind: :replay} = spec), do: "there is no file #{spec.file}"
  def format(:eisdir, %{kind: :replay} = spec), do: "#{spec.file} is a folder"
  def format(:enoent, spec), do: "there is no #{Spec.place(spec)}"
  def format(:ebusy, spec), do: "#{Spec.place(spec)} is in use by another program"
  def format(:eio, spec), do: "#{Spec.place(spec)} was unplugged"
  def format(:nxdomain, spec), do: "the name of #{Spec.place(spec)} is not known"
  def format(:emfile, _spec), do: "this program has too many open files (see ulimit -n)"
  def format({:shutdown, reason}, spec), do: format(reason, spec)

  def format(reason, spec) when is_atom(reason) do
    case :inet.format_error(reason) do
      ~c"unknown POSIX error" ++ _ -> "#{reason} on #{Spec.place(spec)}"
      words -> "#{words} on #{Spec.place(spec)}"
    end
  end

  def format(reason, spec),
    do: "#{Spec.place(spec)} failed: #{inspect(reason, limit: 10, printable_limit: 200)}"

  @doc "A wait in words: `now`, `3.2 s`."
  @spec wait(non_neg_integer) :: String.t()
  def wait(ms) when ms < 50, do: "now"
  def wait(ms), do: "in #{:erlang.float_to_binary(ms / 1000, decimals: 1)} s"

  defp peer(%{kind: :serial} = spec), do: Spec.place(spec)
  defp peer(spec), do: Spec.place(spec)

  defp permission_hint(%{kind: :serial}), do: " (is the user in the group dialout?)"

  defp permission_hint(%{port: port}) when is_integer(port) and port < 1024,
    do: " (ports below 1024 need root)"

  defp permission_hint(_spec), do: ""
end
