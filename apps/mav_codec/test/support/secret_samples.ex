defmodule MavCodec.SecretSamples do
  @moduledoc "Each message that may carry a password or a key, with one in it, for tests of all who must keep it."

  alias MavCodec.Messages, as: M

  @secret "hunter22"
  @fields [
    {M.ChangeOperatorControl, [:passkey]},
    {M.AuthKey, [:key]},
    {M.SetupSigning, [:secret_key]},
    {M.VideoStreamInformation, [:uri]},
    {M.WifiConfigAp, [:password]},
    {M.ParamExtValue, [:param_value]},
    {M.ParamExtSet, [:param_value]},
    {M.ParamExtAck, [:param_value]},
    {M.CellularConfig, [:pin, :new_pin, :puk]},
    {M.SecureCommand, [:data]},
    {M.SecureCommandReply, [:data]},
    {M.AirlinkAuth, [:login, :password]}
  ]

  @spec secret() :: String.t()
  def secret, do: @secret

  @spec modules() :: [module()]
  def modules, do: Enum.map(@fields, &elem(&1, 0))

  @doc "The secret fields of a message."
  @spec fields(module()) :: [atom()]
  def fields(module), do: @fields |> List.keyfind(module, 0) |> elem(1)

  @doc "One of each."
  @spec all() :: [struct()]
  def all, do: for({module, fields} <- @fields, do: module |> struct() |> filled(fields) |> named())

  defp filled(message, fields), do: Enum.reduce(fields, message, &Map.put(&2, &1, @secret))

  defp named(%M.VideoStreamInformation{} = message), do: %{message | uri: "rtsp://ann:#{@secret}@cam"}
  defp named(%{param_id: _none} = message), do: %{message | param_id: "WIFI_Password"}
  defp named(message), do: message
end
