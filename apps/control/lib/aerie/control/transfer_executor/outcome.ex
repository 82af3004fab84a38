defmodule Aerie.Control.TransferExecutor.Outcome do
  @moduledoc """
  Translates the end of a transfer into the terms of `Aerie.Vehicle.Command.Result`. Pure.

  The machines decide whether the vehicle did what was asked; this module turns their reasons into a status and a sentence.
  """

  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Protocols.Mission

  # What machines and the executor give, by the names of its texts.
  @ends ~w(vehicle_unknown vehicle_unheard vehicle_lost high_latency yielded waited lost deadline no_answer rebooted
           changing changed damaged too_large bad_path)a

  @type failure :: {Result.status(), String.t() | nil, details :: map()}

  @doc """
  The value of a success, or status, reason and details. A plan that was sent or cleared always has the latter.
  """
  @spec of(term()) :: {:ok, term()} | failure()
  def of({:ok, :unverified}), do: failure(Refusal.ended(:unverified))
  def of({:ok, value}), do: {:ok, value}
  def of({:error, reason}), do: error(reason)
  def of(%Mission.Result{status: :completed, on_board: :read} = result), do: {:ok, result}
  def of(%Mission.Result{} = result), do: {result.status, result.reason, details(result)}

  defp details(result) do
    %{
      "on_board" => Atom.to_string(result.on_board),
      "items" => result.items && length(result.items),
      "mismatch" => result.mismatch,
      "remarks" => result.remarks,
      "opaque_id" => result.opaque_id,
      "sent" => result.sent,
      "ms" => result.ms
    }
  end

  defp error(text) when is_binary(text), do: {:rejected, text, %{}}
  defp error({:invalid, text}), do: {:rejected, text, %{}}
  defp error({:failed, text}), do: {:failed, text, %{}}
  defp error({:refused, text}) when is_binary(text), do: failure(Refusal.ended(:refused, why: text))
  defp error({:refused, value}), do: failure(Refusal.ended(:keeps, value: value), %{"value" => value})
  defp error({:silent, component}), do: failure(Refusal.ended(:silent, component: component))

  defp error({:not_set, verdict, shown}) do
    {status, text} = not_set(verdict)

    case shown do
      {:keeps, value} -> {status, "#{text}; #{kept(value)}", %{"value" => value}}
      :not_shown when verdict == :accepted -> failure(Refusal.ended(:value_not_shown))
      :not_shown -> {status, text, %{}}
    end
  end

  defp error({:missing, n}), do: failure(Refusal.ended(:missing, n: n), %{"missing" => n})
  defp error({:too_many, n}), do: failure(Refusal.ended(:too_many, n: n))
  defp error(:full), do: failure(Refusal.deny(:transfers_many))
  defp error(:taken), do: failure(Refusal.deny(:transfer_under_way))
  defp error(:file_not_found), do: failure(Refusal.deny(:no_file))
  defp error(:cancelled), do: {:cancelled, nil, %{}}
  defp error(reason) when reason in @ends, do: failure(Refusal.ended(reason))

  # MAVLink FTP's own name for it.
  defp error(reason) when is_atom(reason),
    do: {:failed, Refusal.text(:refused, why: String.replace(Atom.to_string(reason), "_", " ")), %{}}

  defp error({reason, _errno}) when is_atom(reason), do: error(reason)

  defp failure(end_or_denial, more \\ %{}) do
    %{status: status, reason: reason, details: details} = Refusal.result("", end_or_denial)
    {status, reason, Map.merge(details, more)}
  end

  defp not_set(:unsupported), do: Refusal.ended(:unsupported)
  defp not_set(:failed), do: Refusal.ended(:not_set)
  defp not_set(:accepted), do: Refusal.ended(:not_kept)

  defp kept(nil), do: Refusal.text(:keeps_none)
  defp kept(value), do: Refusal.text(:keeps_value, value: value)
end
