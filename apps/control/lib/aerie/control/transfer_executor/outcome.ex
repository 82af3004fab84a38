defmodule Aerie.Control.TransferExecutor.Outcome do
  @moduledoc """
  Translates the end of a transfer into the terms of `Aerie.Vehicle.Command.Result`. Pure.

  The machines decide whether the vehicle did what was asked; this module turns their reasons into a status and a sentence.
  """

  alias Aerie.Vehicle.Command.Result
  alias Protocols.Mission

  @type failure :: {Result.status(), String.t() | nil, details :: map()}

  @doc """
  The value of a success, or status, reason and details. A plan that was sent or cleared always has the latter.
  """
  @spec of(term()) :: {:ok, term()} | failure()
  def of({:ok, :unverified}), do: {:accepted, "the vehicle has no checksums by which to compare it", %{}}
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
  defp error({:unavailable, text}), do: {:rejected, text, %{}}
  defp error({:invalid, text}), do: {:rejected, text, %{}}
  defp error({:refused, text}) when is_binary(text), do: {:rejected, "the vehicle refused it: #{text}", %{}}

  defp error({:refused, value}),
    do: {:rejected, "the vehicle keeps the value #{value}", %{"value" => value}}

  defp error({:silent, component}),
    do:
      {:timeout, "component #{component} does not answer: it is not there, or it has no such parameter", %{}}

  defp error({:not_set, verdict, shown}) do
    {status, text} = not_set(verdict)

    case shown do
      {:keeps, value} -> {status, "#{text}; it keeps #{kept(value)}", %{"value" => value}}
      :not_shown when verdict == :accepted -> {:accepted, "it accepted the value, and does not show it", %{}}
      :not_shown -> {status, text, %{}}
    end
  end

  defp error({:missing, n}), do: {:failed, "#{n} of them never came", %{"missing" => n}}

  defp error({:too_many, n}),
    do: {:failed, "the vehicle says that it has #{n}, more than are read", %{}}

  defp error({:failed, text}), do: {:failed, text, %{}}

  defp error(:full),
    do: {:denied, "as many transfers wait for this vehicle as may; try again", %{"rule" => "busy"}}

  defp error(:taken), do: {:rejected, "a transfer with this id is under way", %{"rule" => "id"}}

  defp error(:yielded),
    do: {:expired, "it made way for another transfer with the vehicle; try again", %{}}

  defp error(:waited),
    do: {:expired, "other transfers with the vehicle were under way until it had to begin", %{}}

  defp error(:lost),
    do: {:unknown, "the vehicle's processes were restarted before its end was known", %{}}

  defp error(:cancelled), do: {:cancelled, nil, %{}}
  defp error(:deadline), do: {:timeout, "its deadline passed before its end", %{}}
  defp error(:no_answer), do: {:timeout, "the vehicle does not answer", %{}}
  defp error(:rebooted), do: {:failed, "the vehicle rebooted", %{}}
  defp error(:changing), do: {:failed, "the list changed each time that it was read", %{}}
  defp error(:changed), do: {:failed, "the file changed while it was read", %{}}
  defp error(:damaged), do: {:failed, "the vehicle's checksum is not that of what was written", %{}}
  defp error(:too_large), do: {:rejected, "it is larger than what is read", %{}}
  defp error(:bad_path), do: {:rejected, "the path is empty, longer than 239 bytes, or has a NUL", %{}}
  defp error(:file_not_found), do: {:rejected, "the vehicle has no such file", %{"rule" => "file"}}

  # MAVLink FTP's own name for it.
  defp error(reason) when is_atom(reason),
    do: {:failed, "the vehicle refused it: " <> String.replace(Atom.to_string(reason), "_", " "), %{}}

  defp error({reason, _errno}) when is_atom(reason), do: error(reason)

  defp not_set(:unsupported), do: {:rejected, "the component does not support this value"}
  defp not_set(:failed), do: {:failed, "the component failed to set it"}
  defp not_set(:accepted), do: {:failed, "the component accepted the value and does not have it"}

  defp kept(nil), do: "no number"
  defp kept(value), do: "#{value}"
end
