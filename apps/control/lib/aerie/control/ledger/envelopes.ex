defmodule Aerie.Control.Ledger.Envelopes do
  @moduledoc """
  The commands of a ledger in the order in which they came, for those who look back. Nothing is opened for writing, so the gateway whose
  ledger it is may run.

  A ledger that was written again has no envelopes of commands that had ended by then.
  """

  alias Aerie.Control.Ledger.Journal

  @typedoc "`:at` - when it came (unix microseconds); `:envelope` - as `Aerie.Vehicle.Command.plain/1` gives it."
  @type entry :: %{at: integer(), id: String.t(), envelope: %{String.t() => term()}}

  @doc "The commands of a ledger's folder; `forgotten`: those without an envelope; `damaged`: lines that cannot be read."
  @spec read(Path.t()) ::
          {:ok, %{entries: [entry()], forgotten: [integer()], damaged: non_neg_integer()}}
          | {:error, String.t()}
  def read(dir) do
    case Journal.fold(dir, {[], []}, &record/2) do
      {:ok, {entries, forgotten}, damaged} ->
        {:ok, %{entries: Enum.sort_by(entries, &{&1.at, &1.id}), forgotten: forgotten, damaged: damaged}}

      {:error, text} ->
        {:error, text}
    end
  end

  defp record(["new", id, _digest, at, %{} = envelope], {entries, forgotten})
       when is_binary(id) and is_integer(at),
       do: {[%{at: at, id: id, envelope: envelope} | entries], forgotten}

  defp record(["new", _id, _digest, at, nil], {entries, forgotten}) when is_integer(at),
    do: {entries, [at | forgotten]}

  defp record(_other, acc), do: acc
end
