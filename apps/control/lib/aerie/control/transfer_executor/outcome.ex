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

  @doc """
  The value of a success, or the result of what has the id. A plan that was sent or cleared always has the latter.
  """
  @spec of(term(), id :: String.t()) :: {:ok, term()} | {:ended, Result.t()}
  def of({:ok, :unverified}, id), do: {:ended, Refusal.result(id, Refusal.ended(:unverified))}
  def of({:ok, value}, _id), do: {:ok, value}

  def of({:error, reason}, id) do
    result = Refusal.result(id, ended(reason))
    {:ended, %{result | details: Map.merge(result.details, found(reason))}}
  end

  def of(%Mission.Result{status: :completed, on_board: :read} = result, _id), do: {:ok, result}

  def of(%Mission.Result{} = result, id),
    do: {:ended, Result.new(id, result.status, result.reason, details(result))}

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

  defp found({:refused, value}) when not is_binary(value), do: %{"value" => value}
  defp found({:not_set, _verdict, {:keeps, value}}), do: %{"value" => value}
  defp found({:missing, n}), do: %{"missing" => n}
  defp found(_other), do: %{}

  defp ended(text) when is_binary(text), do: {:rejected, text}
  defp ended({:invalid, text}), do: {:rejected, text}
  defp ended({:failed, text}), do: {:failed, text}
  defp ended({:refused, text}) when is_binary(text), do: Refusal.ended(:refused, why: text)
  defp ended({:refused, value}), do: Refusal.ended(:keeps, value: value)
  defp ended({:silent, component}), do: Refusal.ended(:silent, component: component)
  defp ended({:not_set, :accepted, :not_shown}), do: Refusal.ended(:value_not_shown)
  defp ended({:not_set, verdict, :not_shown}), do: not_set(verdict)

  defp ended({:not_set, verdict, {:keeps, value}}) do
    {status, text} = not_set(verdict)
    {status, "#{text}; #{kept(value)}"}
  end

  defp ended({:missing, n}), do: Refusal.ended(:missing, n: n)
  defp ended({:too_many, n}), do: Refusal.ended(:too_many, n: n)
  defp ended(:full), do: Refusal.deny(:transfers_many)
  defp ended(:taken), do: Refusal.deny(:transfer_under_way)
  defp ended(:file_not_found), do: Refusal.deny(:no_file)
  defp ended(:cancelled), do: {:cancelled, nil}
  defp ended(reason) when reason in @ends, do: Refusal.ended(reason)

  # MAVLink FTP's own name for it.
  defp ended(reason) when is_atom(reason),
    do: {:failed, Refusal.text(:refused, why: String.replace(Atom.to_string(reason), "_", " "))}

  defp ended({reason, _errno}) when is_atom(reason), do: ended(reason)

  defp not_set(:unsupported), do: Refusal.ended(:unsupported)
  defp not_set(:failed), do: Refusal.ended(:not_set)
  defp not_set(:accepted), do: Refusal.ended(:not_kept)

  defp kept(nil), do: Refusal.text(:keeps_none)
  defp kept(value), do: Refusal.text(:keeps_value, value: value)
end
