defmodule Aerie.Control.Policy.Fence.Json do
  @moduledoc "JSON in which no object has a member twice: of two values of `fence` one would silently have no effect."

  @doc "The value of a text, or a line that says what is wrong with it."
  @spec decode(binary()) :: {:ok, term()} | {:error, String.t()}
  def decode(text) do
    case JSON.decode(text, :ok, object_push: &push/3, object_finish: &finish/2) do
      {value, :ok, rest} ->
        if String.trim(rest) == "", do: {:ok, value}, else: misfit(text, byte_size(text) - byte_size(rest))

      {:error, {_kind, offset, _byte}} ->
        misfit(text, offset)

      {:error, {_kind, offset}} ->
        {:error, "line #{line(text, offset)}: expected JSON, got the end of the file"}
    end
  catch
    {:twice, key} ->
      {:error, ~s(expected each member of an object once, got "#{String.slice(key, 0, 60)}" twice)}
  end

  defp push(key, _value, members) when is_map_key(members, key), do: throw({:twice, key})
  defp push(key, value, members) when is_map(members), do: Map.put(members, key, value)
  defp push(key, value, _start), do: %{key => value}

  defp finish(members, above), do: {if(is_map(members), do: members, else: %{}), above}

  defp misfit(text, offset),
    do: {:error, "line #{line(text, offset)}: expected JSON, got a character that does not fit there"}

  defp line(text, offset),
    do: text |> binary_part(0, min(offset, byte_size(text))) |> String.split("\n") |> length()
end
