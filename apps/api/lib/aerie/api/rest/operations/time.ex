defmodule Aerie.Api.Rest.Operations.Time do
  @moduledoc "A time in a request: ISO 8601 with its offset, or unix seconds. It is read as unix microseconds."

  import Aerie.Base.Json.Schema

  alias Aerie.Base.Settings.Field

  # The end of year 9999, the last one that ISO 8601 writes with four digits.
  @last_s 253_402_300_799

  @doc "A field of an operation; the options are those of `Aerie.Base.Settings.Field.field/4`."
  @spec field(atom(), String.t(), keyword()) :: Field.t()
  def field(key, meaning, options \\ []) do
    words = "a time such as 2026-11-22T10:15:00Z, or unix seconds"
    schema = %{anyOf: [time(), number(0, @last_s)]}
    meaning = "#{meaning}: ISO 8601 with its offset, or unix seconds"
    Field.field(key, {:term, &read/1, words}, meaning, [schema: schema] ++ options)
  end

  defp read(text) do
    with {:error, _no_date} <- DateTime.from_iso8601(text),
         {seconds, ""} when seconds >= 0 and seconds <= @last_s <- Float.parse(text) do
      {:ok, round(seconds * 1_000_000)}
    else
      {:ok, time, _offset} -> {:ok, DateTime.to_unix(time, :microsecond)}
      _neither -> :error
    end
  end
end
