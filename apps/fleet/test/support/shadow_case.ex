defmodule Aerie.ShadowCase do
  @moduledoc "Tests of the shadow's processes: its supervisor and loops of their own, in folders of their own."
  use ExUnit.CaseTemplate

  alias Aerie.Base.Names
  alias Aerie.Fleet.Shadow

  using do
    quote do
      import Aerie.BridgeCase
      import Aerie.CommandCase
      import Aerie.ShadowCase
      alias Aerie.Base.Store
      alias Aerie.Fleet.{Bridge, Shadow}
      alias Aerie.Fleet.Shadow.Documents
      alias Aerie.TestBucket, as: KV
    end
  end

  @key {"main", 7}

  @doc "The shadow's settings with some keys of the configuration; without NATS unless one of them says otherwise."
  @spec shadow_settings(Path.t(), [{String.t(), term()}]) :: Shadow.Settings.t()
  def shadow_settings(dir, overrides \\ []) do
    raw =
      Enum.reduce(
        [{"environment", "test"}, {"nats.mode", "off"}, {"shadow.dir", Path.join(dir, "shadow")}] ++ overrides,
        %{},
        fn {key, value}, raw ->
          put_in(raw, key |> String.split(".") |> Enum.map(&Access.key(&1, %{})), value)
        end
      )

    {:ok, settings} = Shadow.Settings.new(raw)
    settings
  end

  @doc "Starts what the loops of a gateway share."
  @spec start_shadow(reference(), Path.t(), [{String.t(), term()}]) :: pid()
  def start_shadow(gateway, dir, overrides \\ []) do
    ExUnit.Callbacks.start_supervised!(
      {Shadow.Supervisor, gateway: gateway, settings: shadow_settings(dir, overrides)},
      id: {:shadow, gateway},
      restart: :temporary
    )
  end

  @doc "Starts the loop of VID-007."
  @spec start_loop(reference()) :: pid()
  def start_loop(gateway) do
    ExUnit.Callbacks.start_supervised!(
      {Shadow.Loop, gateway: gateway, options: %{id: "VID-007", key: @key}},
      id: {:loop, gateway},
      restart: :temporary
    )
  end

  @doc "Waits until a field of VID-007 stands so; gives how."
  @spec standing(reference(), String.t(), atom()) :: map()
  def standing(gateway, path, state) do
    Aerie.Patience.eventually(fn ->
      with %{^path => %{state: ^state} = status} <- Shadow.report(gateway, "VID-007"),
           do: status,
           else: (_other -> false)
    end)
  end

  @doc "Waits until a field of VID-007 is held by `by`, whatever held it before; gives how."
  @spec held(reference(), String.t(), String.t()) :: map()
  def held(gateway, path, by) do
    Aerie.Patience.eventually(fn ->
      with %{by: ^by} = status <- standing(gateway, path, :held), do: status, else: (_other -> false)
    end)
  end

  @doc "A document as earlier versions sealed those of all vehicles: with the common key."
  @spec sealed_before(Shadow.Document.t(), environment :: String.t(), Shadow.Keys.t()) :: String.t()
  def sealed_before(document, environment, %Shadow.Keys{common: key}) do
    plain = Shadow.Document.plain(document)
    text = JSON.encode!(["aerie-shadow-1", environment, sorted(plain)])
    seal = :hmac |> :crypto.mac(:sha256, Aerie.Base.Secret.reveal(key), text) |> Base.encode16(case: :lower)
    JSON.encode!(Map.put(plain, "seal", seal))
  end

  defp sorted(map) when is_map(map), do: for({key, value} <- Enum.sort(map), do: [key, sorted(value)])
  defp sorted(list) when is_list(list), do: Enum.map(list, &sorted/1)
  defp sorted(value), do: value

  @doc "The documents of a gateway."
  @spec documents(reference()) :: pid()
  def documents(gateway), do: Names.whereis(gateway, :shadow_documents)
end
