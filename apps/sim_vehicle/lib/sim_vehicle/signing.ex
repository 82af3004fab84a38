defmodule SimVehicle.Signing do
  @moduledoc """
  Signed links as ArduPilot has them: it takes SETUP_SIGNING from whoever may speak to it, unless it is armed, from then on
  signs everything and asks for signatures, RADIO_STATUS and RADIO excepted; a key and a time stamp of zeros end that. On a
  link that counts as USB it hears unsigned and wrongly signed frames too. The key survives a reboot.

  PX4 (1.18) is like it, but takes unsigned heartbeats from everybody.
  """

  alias MavCodec.Frame
  alias MavCodec.Messages.SetupSigning

  # Message ids that need no signature (S7).
  @unsigned %{ardupilot: [109, 166], px4: [0, 109]}

  @enforce_keys [:secure]
  defstruct [:secure, :state, firmware: :ardupilot]

  @type t :: %__MODULE__{
          secure: boolean,
          state: MavCodec.Signing.t() | nil,
          firmware: :ardupilot | :px4
        }

  @doc "With a key from the start, or none; `secure` as USB is."
  @spec new(binary | nil, boolean, :ardupilot | :px4) :: t
  def new(key, secure, firmware \\ :ardupilot) do
    signing = %__MODULE__{secure: secure, firmware: firmware}
    if key, do: with_key(signing, key, 0), else: signing
  end

  defp with_key(signing, key, at) do
    options = [stored: at, accept_unsigned: Map.fetch!(@unsigned, signing.firmware)]
    %{signing | state: MavCodec.Signing.new(key, options)}
  end

  @doc "The frame of a message as it goes out."
  @spec sign(t, binary, struct, module) :: {binary, t}
  def sign(%{state: nil} = signing, bytes, _message, _dialect), do: {bytes, signing}
  def sign(signing, <<0xFE, _::binary>> = bytes, _message, _dialect), do: {bytes, signing}

  def sign(signing, bytes, %module{}, dialect) do
    {_id, extra, _base, _extended} = dialect.layout(module)
    {bytes, state} = MavCodec.Signing.sign(signing.state, bytes, extra)
    {bytes, %{signing | state: state}}
  end

  @doc "Whether a frame is heard."
  @spec check(t, Frame.t()) :: {:ok | :refused, t}
  def check(%{state: nil} = signing, _frame), do: {:ok, signing}

  def check(signing, frame) do
    case MavCodec.Signing.check(signing.state, frame) do
      {{:rejected, _why}, state} -> {if(signing.secure, do: :ok, else: :refused), %{signing | state: state}}
      {_right, state} -> {:ok, %{signing | state: state}}
    end
  end

  @doc "SETUP_SIGNING came, for whomever."
  @spec setup(t, SetupSigning.t(), map) :: t
  def setup(%{firmware: :ardupilot} = signing, _setup, %{armed: true}), do: signing

  def setup(signing, %{target_system: system} = setup, %{system: system}) do
    case setup do
      %{secret_key: <<0::256>>, initial_timestamp: 0} -> %{signing | state: nil}
      %{secret_key: key, initial_timestamp: at} -> with_key(signing, key, at)
    end
  end

  def setup(signing, _for_another, _vehicle), do: signing
end
