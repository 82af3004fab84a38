defmodule MavCodec.Generated.Messages.Part8 do
  use MavCodec.Definition.Shard, messages: {8, 8}
end
